"use strict";
// Draws the robot and the object on plain 2D canvases: no WebGL, and it prints.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const root = document.getElementById("playback");
  const [playButton, slider, clock, looksButton, resetButton] =
    ["play", "frame", "clock", "looks", "reset"].map((id) => document.getElementById(id));
  const camera = sceneCamera(scene.view);
  const LINE = "#3a86b0", FORCE = "#c2187f", WEIGHT = "#333", WALL_EDGE = "#9c4f7c", AXES = ["#c0392b", "#1e8449", "#1f5fa8"];
  const INSIDE = 0, AT = 1;
  const TRAIL = 30; // frames; of a law that loses its way more would hide the arms
  const MARK = { at: "#E69F00", beyond: "#C1121F", floor: "#dfe3e7" };
  const ARMS = ["#3d4852", "#76688c", "#4a6b57", "#8a5a5e"];
  const SURFACES = [[158, 182, 210], [204, 190, 222], [166, 204, 182], [220, 184, 186]]; // of arms
  const STILL = [228, 230, 232], OBJECT = [242, 218, 146];
  const PLANE = [86, 180, 233], WALL = [204, 121, 167]; // of tasks, of limits
  const OPACITY = 0.9, OPACITY_OF_PLANES = 0.3;
  const STEP = 0.012; // of the view's diagonal: a jump in distance that has an outline
  const middle = scene.view.low.map((low, i) => (low + scene.view.high[i]) / 2);
  const last = scene.t.length - 1;
  const layer = surfaceLayer();
  let frame = last, playing = false, bodies = true;

  const add = (a, b) => a.map((x, i) => x + b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((x) => x / Math.hypot(...a));
  const distance = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));
  const diagonal = distance(scene.view.low, scene.view.high);
  const counts = ({ first, last }) => first <= frame && frame <= last; // its phase
  const now = (mark, key) => mark[key][frame - mark.first]; // what moves has a value a frame
  const mean = (points) => points.reduce(add).map((x) => x / points.length);

  function corners(position, rotation) {
    const half = scene.size.map((edge) => edge / 2);
    return [...Array(8).keys()].map((k) => {
      const local = [k & 1, (k >> 1) & 1, (k >> 2) & 1].map((bit, i) => (bit ? half[i] : -half[i]));
      return add(position, [0, 1, 2].map((row) => dot(rotation.slice(3 * row, 3 * row + 3), local)));
    });
  }
  const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];

  function painter(canvas) {
    const ratio = Math.max(2, window.devicePixelRatio || 1); // sharp on paper, too
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineCap = pen.lineJoin = "round";
    const view = camera.axes(), { scale, center } = camera.fit(width, height);
    const at = (p) => {
      const d = p.map((x, i) => x - middle[i]);
      return [center[0] + scale * dot(d, view.right), center[1] - scale * dot(d, view.up)];
    };
    const path = (points, closed) => {
      pen.beginPath();
      points.forEach((p, i) => (i ? pen.lineTo(...at(p)) : pen.moveTo(...at(p))));
      if (closed) pen.closePath();
    };
    const depth = (points) => dot(mean(points), view.toViewer);
    return { pen, at, path, depth, width, height, ratio, center, scale, view };
  }

  const LEVEL = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  // Rotation of a quaternion (x y z w), row by row.
  const matrix = ([x, y, z, w]) => [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)];

  // Points, three numbers each, from a body's frame to pixels of the layer.
  function pixelsOf(points, position, rotation, { view, center, scale, ratio }) {
    const size = scale * ratio, out = new Float32Array(points.length);
    const start = [ratio * center[0], ratio * center[1], 0];
    [view.right, view.up.map((x) => -x), view.toViewer].forEach((axis, k) => {
      const [x, y, z] = [0, 1, 2].map((i) => size * dot(axis, [rotation[i], rotation[3 + i], rotation[6 + i]]));
      const offset = start[k] + size * position.reduce((sum, p, i) => sum + axis[i] * (p - middle[i]), 0);
      for (let i = 0; i < out.length; i += 3)
        out[i + k] = offset + x * points[i] + y * points[i + 1] + z * points[i + 2];
    });
    return out;
  }

  // Each owner has an outline: all that stands still, each arm, each face of the object, each plane.
  function drawBodies(brush, run) {
    layer.clear(Math.round(brush.width * brush.ratio), Math.round(brush.height * brush.ratio));
    let next = 0;
    for (const { moves, arm, vertices, triangles } of scene.bodies) {
      const pose = moves ? run.poses[frame].slice(next, (next += 7)) : [0, 0, 0, 0, 0, 0, 1];
      const p = pixelsOf(vertices, pose.slice(0, 3), matrix(pose.slice(3)), brush);
      const color = arm === null ? STILL : SURFACES[arm % SURFACES.length];
      const owner = arm === null ? 1 : 2 + arm;
      for (let i = 0; i < triangles.length; i += 3)
        layer.triangle(p, 3 * triangles[i], 3 * triangles[i + 1], 3 * triangles[i + 2], color, owner);
    }
    let owner = 2 + run.arms.length;
    const box = pixelsOf(corners([0, 0, 0], LEVEL).flat(), run.position[frame], run.rotation[frame], brush);
    for (const face of FACES) drawFace(box, face, OBJECT, owner++);
    for (const plane of scene.planes.filter(counts)) {
      const p = pixelsOf(now(plane, "corners").flat(), [0, 0, 0], LEVEL, brush);
      drawFace(p, [0, 1, 2, 3], plane.limit ? WALL : PLANE, owner++, OPACITY_OF_PLANES);
    }
    layer.outline(STEP * diagonal * brush.scale * brush.ratio);
    layer.paint(brush.pen, brush.width, brush.height, OPACITY);
  }

  function drawFace(p, [a, b, c, d], color, owner, share = 1) {
    layer.triangle(p, 3 * a, 3 * b, 3 * c, color, owner, share);
    layer.triangle(p, 3 * a, 3 * c, 3 * d, color, owner, share);
  }

  function drawBox(brush, run, parts) {
    const box = corners(run.position[frame], run.rotation[frame]);
    for (const face of FACES) {
      const points = face.map((i) => box[i]);
      parts.push([brush.depth(points), () => polygon(brush, points, "rgba(240,228,190,0.72)", "#8a7a45", 1.2)]);
    }
  }

  function drawFloor({ pen, path }) {
    const [low, high] = [scene.view.low, scene.view.high];
    pen.strokeStyle = MARK.floor;
    pen.lineWidth = 1;
    for (let i = 0; i <= 6; i++) {
      const x = low[0] + ((high[0] - low[0]) * i) / 6, y = low[1] + ((high[1] - low[1]) * i) / 6;
      path([[x, low[1], low[2]], [x, high[1], low[2]]]); pen.stroke();
      path([[low[0], y, low[2]], [high[0], y, low[2]]]); pen.stroke();
    }
  }

  function polygon({ pen, path }, points, fill, edge, width) {
    path(points, true);
    pen.fillStyle = fill; pen.fill();
    pen.strokeStyle = edge; pen.lineWidth = width; pen.stroke();
  }

  function segment({ pen, path }, ends, color) {
    path(ends); pen.strokeStyle = "white"; pen.lineWidth = bodies ? 4 : 11; pen.stroke();
    path(ends); pen.strokeStyle = color; pen.lineWidth = bodies ? 2 : 7.5; pen.stroke();
  }

  function joint({ pen, at }, point, state) {
    const [x, y] = at(point);
    pen.beginPath();
    if (state === INSIDE) pen.arc(x, y, 4, 0, 7);
    else if (state === AT) pen.rect(x - 6, y - 6, 12, 12);
    else [[0, -9], [9, 0], [0, 9], [-9, 0]].forEach(([a, b], i) =>
      i ? pen.lineTo(x + a, y + b) : pen.moveTo(x + a, y + b));
    pen.closePath();
    pen.fillStyle = state === INSIDE ? "white" : state === AT ? MARK.at : MARK.beyond;
    pen.fill();
    pen.strokeStyle = "#222"; pen.lineWidth = 1.4; pen.stroke();
  }

  function target({ pen, at }, goal) {
    const [x, y] = at(now(goal, "at"));
    for (const [color, width] of [["white", 5], ["#111", 2]]) {
      pen.strokeStyle = color; pen.lineWidth = width;
      pen.beginPath(); pen.arc(x, y, 7, 0, 7);
      pen.moveTo(x - 12, y); pen.lineTo(x + 12, y); pen.moveTo(x, y - 12); pen.lineTo(x, y + 12);
      pen.stroke();
    }
  }

  // On white, so that it is seen on whatever it crosses.
  function stroke(pen, color) {
    for (const [shade, width] of [["white", 4.5], [color, 2]]) {
      pen.strokeStyle = shade; pen.lineWidth = width; pen.stroke();
    }
  }

  function line({ pen, path }, points, color = LINE, closed = false) {
    path(points, closed);
    stroke(pen, color);
  }

  function arrow(brush, start, way, color = LINE) {
    const end = add(start, way);
    line(brush, [start, end], color);
    const [[a, b], [x, y]] = [brush.at(start), brush.at(end)], size = Math.hypot(x - a, y - b) || 1;
    const [c, s] = [(9 * (x - a)) / size, (9 * (y - b)) / size];
    brush.pen.beginPath();
    brush.pen.moveTo(x - c - s / 2, y - s + c / 2); brush.pen.lineTo(x, y);
    brush.pen.lineTo(x - c + s / 2, y - s - c / 2);
    stroke(brush.pen, color);
  }

  function circle(brush, mark) {
    const [n, r] = [now(mark, "normal"), now(mark, "radius")];
    const a = unit(cross(n, Math.abs(n[0]) < 0.6 ? [1, 0, 0] : [0, 1, 0])), b = cross(n, a);
    line(brush, [...Array(60).keys()].map((i) => {
      const [c, s] = [r * Math.cos((Math.PI * i) / 30), r * Math.sin((Math.PI * i) / 30)];
      return add(now(mark, "center"), a.map((x, k) => c * x + s * b[k]));
    }), LINE, true);
  }

  // Its outline, and a dot in its middle.
  function sphere({ pen, at, scale }, mark) {
    const [x, y] = at(now(mark, "center"));
    pen.beginPath(); pen.arc(x, y, scale * now(mark, "radius"), 0, 7);
    stroke(pen, LINE);
    pen.beginPath(); pen.arc(x, y, 1.5, 0, 7);
    stroke(pen, LINE);
  }

  function frameAxes(brush, origin, axes) {
    const { pen, at } = brush;
    pen.font = "bold 11px system-ui, sans-serif"; pen.textAlign = "center";
    axes.forEach((axis, i) => {
      line(brush, [origin, add(origin, axis)], AXES[i]);
      const [x, y] = at(add(origin, axis.map((part) => 1.2 * part)));
      pen.strokeStyle = "white"; pen.lineWidth = 3; pen.strokeText("xyz"[i], x, y + 4);
      pen.fillStyle = AXES[i]; pen.fillText("xyz"[i], x, y + 4);
    });
  }

  function posture(brush, points) {
    brush.pen.setLineDash([5, 5]);
    line(brush, points);
    brush.pen.setLineDash([]);
  }

  // Marks of tasks and limits; those without a place are at the object.
  function drawMarks(brush, run) {
    const each = (marks, paint) => marks.filter(counts).forEach(paint);
    const here = run.position[frame];
    each(scene.lines, (mark) => line(brush, now(mark, "ends")));
    each(scene.directions, (mark) => arrow(brush, here, now(mark, "way")));
    each(scene.circles, (mark) => circle(brush, mark));
    each(scene.spheres, (mark) => sphere(brush, mark));
    each(scene.poses, (mark) => frameAxes(brush, now(mark, "at"), now(mark, "axes")));
    each(scene.orientations, (mark) => frameAxes(brush, here, now(mark, "axes")));
    each(run.relatives, (mark) => frameAxes(brush, now(mark, "at"), now(mark, "axes")));
    each(run.postures, (mark) => posture(brush, now(mark, "points")));
    each(scene.goals, (mark) => target(brush, mark));
  }

  // What hands do to the object ends where they touch it; the weight begins in its centre of mass.
  function drawForces(brush, { forces }) {
    if (!forces) return;
    const paint = (values, color) => {
      if (values.slice(3).some((x) => x)) arrow(brush, values.slice(0, 3), values.slice(3), color);
    };
    paint(forces.weight[frame], WEIGHT);
    forces.hands[frame].forEach((values) => paint(values, FORCE));
  }

  function trail({ pen, path }, { first, points }, color) {
    const shown = frame - first + 1;
    if (shown < 1) return;
    const long = points.slice(1).reduce((sum, p, i) => sum + distance(p, points[i]), 0) > 2 * diagonal;
    path(points.slice(long ? Math.max(0, shown - TRAIL) : 0, shown)); pen.strokeStyle = color; pen.lineWidth = 2; pen.stroke();
  }

  // Beside the part that no other arm has and that is farthest from the middle of all of them.
  function label({ pen, at }, arm, color) {
    const [x, y] = at(arm.points[frame][arm.label]), [a, b] = at(arm.middle);
    const size = Math.hypot(x - a, y - b) || 1;
    pen.font = "bold 12px system-ui, sans-serif"; pen.textAlign = "center";
    const place = [arm.name, x + (24 * (x - a)) / size, y + (18 * (y - b)) / size + 4];
    pen.strokeStyle = "white"; pen.lineWidth = 4; pen.strokeText(...place);
    pen.fillStyle = color; pen.fillText(...place);
  }

  function triad({ pen, view, height }) {
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = "#666"; pen.textAlign = "left";
    pen.strokeStyle = "#888"; pen.lineWidth = 1.4;
    ["x", "y", "z"].forEach((name, i) => {
      const [a, b] = [26 * view.right[i], -26 * view.up[i]];
      pen.beginPath(); pen.moveTo(34, height - 30); pen.lineTo(34 + a, height - 30 + b); pen.stroke();
      pen.fillText(name, 31 + 1.3 * a, height - 26 + 1.3 * b);
    });
  }

  function draw(canvas, run) {
    if (!canvas.clientWidth || !canvas.clientHeight) return; // not laid out
    const brush = painter(canvas);
    drawFloor(brush);
    if (bodies) drawBodies(brush, run);
    drawLines(brush, run);
    drawJoints(brush, run);
    run.arms.forEach((arm, i) => label(brush, arm, ARMS[i % ARMS.length]));
    run.tracked.forEach((way) => trail(brush, way, run.color));
    drawMarks(brush, run);
    drawForces(brush, run);
    triad(brush);
  }

  // The arms as lines; without bodies also the object and the planes, farthest first.
  function drawLines(brush, run) {
    const parts = [];
    if (!bodies) {
      for (const plane of scene.planes.filter(counts))
        polygon(brush, now(plane, "corners"), ...(plane.limit
          ? ["rgba(204,121,167,0.25)", WALL_EDGE, 1] : ["rgba(86,180,233,0.25)", LINE, 1]));
      drawBox(brush, run, parts);
    }
    run.arms.forEach((arm, number) => {
      const points = arm.points[frame], color = ARMS[number % ARMS.length];
      points.slice(1).forEach((end, i) => {
        const ends = [points[i], end];
        if (distance(end, points[i]) > 1e-6)
          parts.push([brush.depth(ends), () => segment(brush, ends, color)]);
      });
    });
    parts.sort((a, b) => a[0] - b[0]).forEach(([, paint]) => paint());
  }

  // On top of everything. Where joints lie in one place, such as a shoulder, the worst comes last.
  function drawJoints(brush, run) {
    const parts = run.arms.flatMap((arm) => arm.points[frame].slice(0, -1).map((point, i) => {
      const state = arm.state[frame][i];
      return [brush.depth([point]) + 0.02 * state * diagonal, point, state];
    }));
    parts.sort((a, b) => a[0] - b[0]).forEach(([, point, state]) => joint(brush, point, state));
  }

  const panes = scene.controllers.map((run, i) => {
    const pane = root.querySelectorAll(".pane")[i];
    return { run, canvas: pane.querySelector("canvas"), readout: pane.querySelector(".readout") };
  });

  function show(next) {
    frame = next;
    slider.value = frame;
    clock.textContent = `${scene.t[frame].toFixed(2)} s`;
    for (const { run, canvas, readout } of panes) {
      draw(canvas, run);
      readout.textContent = run.readout[frame].join("  ·  ");
    }
    root.dataset.time = scene.t[frame]; // for the cursors of the figures
    root.dispatchEvent(new Event("time"));
  }

  function play(on) {
    playing = on;
    playButton.textContent = playing ? "❚❚ Pause" : "▶ Play";
    if (!playing) return;
    const first = frame === last ? 0 : frame;
    const began = performance.now() - 1000 * scene.t[first];
    const tick = (now) => {
      if (!playing) return;
      const elapsed = (now - began) / 1000;
      show(Math.max(0, scene.t.findLastIndex((t) => t <= elapsed)));
      if (elapsed >= scene.duration) play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  const shown = {
    goal: scene.goals,
    plane: scene.planes.filter((plane) => !plane.limit),
    wall: scene.planes.filter((plane) => plane.limit),
    line: [...scene.lines, ...scene.circles, ...scene.spheres],
    way: scene.directions,
    axes: [...scene.poses, ...scene.orientations, ...panes.flatMap(({ run }) => run.relatives)],
    posture: panes.flatMap(({ run }) => run.postures),
    trail: scene.controllers.flatMap((run) => run.tracked),
    force: scene.controllers.filter((run) => run.forces),
    weight: scene.controllers.filter((run) => run.forces),
  };
  for (const [name, marks] of Object.entries(shown))
    document.getElementById(`${name}-key`).hidden = !marks.length;
  document.getElementById("notes").textContent = scene.notes.join(" · ");
  slider.max = last;
  slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
  playButton.addEventListener("click", () => play(!playing));
  looksButton.addEventListener("click", () => {
    bodies = !bodies;
    looksButton.textContent = bodies ? "Skeleton" : "Bodies";
    show(frame);
  });
  resetButton.addEventListener("click", () => { camera.reset(); show(frame); });
  window.addEventListener("resize", () => show(frame));
  root.addEventListener("seek", ({ detail: t }) => {
    const off = scene.t.map((then) => Math.abs(then - t));
    play(false);
    show(off.indexOf(Math.min(...off)));
  });
  panes.forEach(({ canvas }) => camera.attach(canvas, () => show(frame)));
  show(last);
})();
