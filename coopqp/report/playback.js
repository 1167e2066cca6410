"use strict";
// Draws the arms and the object on plain 2D canvases: no WebGL, and it prints.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const root = document.getElementById("playback");
  const [playButton, slider, clock, resetButton] =
    ["play", "frame", "clock", "reset"].map((id) => document.getElementById(id));
  const HOME = { azimuth: 0.65, elevation: 0.42 };
  const camera = { ...HOME };
  const INSIDE = 0, AT = 1;
  const TRAIL = 30; // frames; of a law that loses its way more would hide the arms
  const MARK = { at: "#E69F00", beyond: "#C1121F", arm: ["#3d4852", "#8592a0"], floor: "#dfe3e7" };
  const middle = scene.view.low.map((low, i) => (low + scene.view.high[i]) / 2);
  const last = scene.t.length - 1;
  let frame = last, playing = false;

  const add = (a, b) => a.map((x, i) => x + b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const distance = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));
  const diagonal = distance(scene.view.low, scene.view.high);
  const mean = (points) => points.reduce(add).map((x) => x / points.length);

  function axes() {
    const [ca, sa] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth)];
    const [ce, se] = [Math.cos(camera.elevation), Math.sin(camera.elevation)];
    return { right: [-sa, ca, 0], up: [-ca * se, -sa * se, ce], toViewer: [ca * ce, sa * ce, se] };
  }

  // The largest scale at which the whole view fits, whichever way it is turned about z.
  function scaleFor(width, height) {
    const [x, y, z] = scene.view.high.map((high, i) => high - scene.view.low[i]);
    const across = Math.hypot(x, y);
    const tall = z * Math.cos(camera.elevation) + across * Math.abs(Math.sin(camera.elevation));
    return 0.9 * Math.min(width / across, height / tall);
  }

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
    const view = axes(), scale = scaleFor(width, height);
    const at = (p) => {
      const d = p.map((x, i) => x - middle[i]);
      return [width / 2 + scale * dot(d, view.right), height / 2 - scale * dot(d, view.up)];
    };
    const path = (points, closed) => {
      pen.beginPath();
      points.forEach((p, i) => (i ? pen.lineTo(...at(p)) : pen.moveTo(...at(p))));
      if (closed) pen.closePath();
    };
    const depth = (points) => dot(mean(points), view.toViewer);
    return { pen, at, path, depth, height, view };
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
    path(ends); pen.strokeStyle = "white"; pen.lineWidth = 11; pen.stroke();
    path(ends); pen.strokeStyle = color; pen.lineWidth = 7.5; pen.stroke();
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
    const [x, y] = at(goal.at);
    for (const [color, width] of [["white", 5], ["#111", 2]]) {
      pen.strokeStyle = color; pen.lineWidth = width;
      pen.beginPath(); pen.arc(x, y, 7, 0, 7);
      pen.moveTo(x - 12, y); pen.lineTo(x + 12, y); pen.moveTo(x, y - 12); pen.lineTo(x, y + 12);
      pen.stroke();
    }
  }

  function trail({ pen, path }, points, color) {
    const long = points.slice(1).reduce((sum, p, i) => sum + distance(p, points[i]), 0) > 2 * diagonal;
    path(points.slice(long ? Math.max(0, frame - TRAIL) : 0, frame + 1)); pen.strokeStyle = color; pen.lineWidth = 2; pen.stroke();
  }

  // Beside the base, on the side that the arm does not go to.
  function label({ pen, at }, name, points) {
    const [x, y] = at(points[0]);
    const next = points.find((p) => distance(p, points[0]) > 0.02 * diagonal) || points[0];
    const [a, b] = [at(next)[0] - x, at(next)[1] - y], size = Math.hypot(a, b) || 1;
    pen.fillText(name, x - (22 * a) / size, y - (17 * b) / size + 4);
  }

  function triad({ pen, view, height }) {
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = "#666";
    pen.strokeStyle = "#888"; pen.lineWidth = 1.4;
    ["x", "y", "z"].forEach((name, i) => {
      const [a, b] = [26 * view.right[i], -26 * view.up[i]];
      pen.beginPath(); pen.moveTo(34, height - 30); pen.lineTo(34 + a, height - 30 + b); pen.stroke();
      pen.fillText(name, 31 + 1.3 * a, height - 26 + 1.3 * b);
    });
  }

  function draw(canvas, run) {
    const brush = painter(canvas), { pen, at, depth } = brush, parts = [];
    drawFloor(brush);
    for (const plane of scene.planes)
      polygon(brush, plane.corners[frame], "rgba(86,180,233,0.25)", "#3a86b0", 1);
    const box = corners(run.position[frame], run.rotation[frame]);
    for (const face of FACES) {
      const points = face.map((i) => box[i]);
      parts.push([depth(points), () => polygon(brush, points, "rgba(240,228,190,0.72)", "#8a7a45", 1.2)]);
    }
    run.arms.forEach((arm, number) => {
      const points = arm.points[frame], color = MARK.arm[number % 2];
      points.slice(1).forEach((end, i) => {
        const ends = [points[i], end];
        if (distance(end, points[i]) > 1e-6)
          parts.push([depth(ends), () => segment(brush, ends, color)]);
      });
      // Where joints lie in one place, such as a shoulder, the worst is drawn on top.
      points.slice(0, -1).forEach((point, i) => {
        const state = arm.state[frame][i];
        parts.push([depth([point]) + (0.05 + 0.02 * state) * diagonal, () => joint(brush, point, state)]);
      });
    });
    parts.sort((a, b) => a[0] - b[0]).forEach(([, paint]) => paint());
    run.tracked.forEach((points) => trail(brush, points, run.color));
    scene.goals.forEach((goal) => target(brush, goal));
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = "#555";
    pen.textAlign = "center";
    run.arms.forEach((arm) => label(brush, arm.name, arm.points[frame]));
    pen.textAlign = "left";
    triad(brush);
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

  function turn(canvas) {
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      camera.azimuth -= 0.008 * event.movementX;
      camera.elevation = Math.min(1.55, Math.max(-0.3, camera.elevation + 0.008 * event.movementY));
      show(frame);
    });
  }

  document.getElementById("goal-key").hidden = !scene.goals.length;
  document.getElementById("plane-key").hidden = !scene.planes.length;
  slider.max = last;
  slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
  playButton.addEventListener("click", () => play(!playing));
  resetButton.addEventListener("click", () => { Object.assign(camera, HOME); show(frame); });
  window.addEventListener("resize", () => show(frame));
  panes.forEach(({ canvas }) => turn(canvas));
  show(last);
})();
