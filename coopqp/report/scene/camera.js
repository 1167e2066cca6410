"use strict";
// Where all pictures are seen from: turned, moved and enlarged together by mouse or fingers.
// view has the lowest and the highest corner of what is shown, and its rims.
function sceneCamera(view) {
  const HOME = { azimuth: 0.65, elevation: 0.42, zoom: 1, shift: [0, 0] }; // shift: [m] on screen
  const CLOSEST = 20, FARTHEST = 0.3, FILLED = 0.9;
  const TURN = 0.008, WHEEL = 0.0025, MOST_WHEEL = 60; // rad and share a pixel
  const camera = { ...HOME };
  const fingers = new Map(); // pointers that are down, by id: [x, y]

  const reset = () => Object.assign(camera, HOME);

  function axes() {
    const [ca, sa] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth)];
    const [ce, se] = [Math.cos(camera.elevation), Math.sin(camera.elevation)];
    return { right: [-sa, ca, 0], up: [-ca * se, -sa * se, ce], toViewer: [ca * ce, sa * ce, se] };
  }

  // At zoom 1 the largest scale at which the whole view fits, whichever way it is turned about z.
  function fit(width, height) {
    const across = 2 * Math.max(...view.rims.map(([, radius]) => radius));
    const [c, s] = [Math.cos(camera.elevation), Math.abs(Math.sin(camera.elevation))];
    const top = Math.max(...view.rims.map(([z, radius]) => z * c + radius * s));
    const bottom = Math.min(...view.rims.map(([z, radius]) => z * c - radius * s));
    const scale = camera.zoom * FILLED * Math.min(width / across, height / (top - bottom));
    const [x, y] = camera.shift;
    return { scale, center: [width / 2 + scale * x, height / 2 + scale * (y + (top + bottom) / 2)] };
  }

  function turn(x, y) {
    camera.azimuth -= TURN * x;
    camera.elevation = Math.min(1.55, Math.max(-0.3, camera.elevation + TURN * y));
  }

  function move(canvas, x, y) {
    const { scale } = fit(canvas.clientWidth, canvas.clientHeight);
    camera.shift = [camera.shift[0] + x / scale, camera.shift[1] + y / scale];
  }

  // What is at [x, y], pixels of the canvas, stays there.
  function enlarge(canvas, factor, [x, y]) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const before = fit(width, height).scale;
    camera.zoom = Math.min(CLOSEST, Math.max(FARTHEST, factor * camera.zoom));
    const change = 1 / fit(width, height).scale - 1 / before;
    const [a, b] = camera.shift;
    camera.shift = [a + (x - width / 2) * change, b + (y - height / 2) * change];
  }

  const spread = ([[a, b], [x, y]]) => Math.hypot(x - a, y - b);
  const middle = ([[a, b], [x, y]]) => [(a + x) / 2, (b + y) / 2];

  // Two fingers move and enlarge; one, or the mouse, turns, or moves with Shift or another button.
  function drag(canvas, event) {
    const here = [event.offsetX, event.offsetY], from = fingers.get(event.pointerId);
    const before = [...fingers.values()];
    fingers.set(event.pointerId, here);
    const after = [...fingers.values()];
    const [x, y] = [here[0] - from[0], here[1] - from[1]];
    if (after.length === 2) {
      const [[a, b], [c, d]] = [middle(before), middle(after)];
      move(canvas, c - a, d - b);
      enlarge(canvas, spread(after) / (spread(before) || 1), [c, d]);
    } else if (event.shiftKey || event.buttons > 1) move(canvas, x, y);
    else turn(x, y);
  }

  function attach(canvas, redraw) {
    const lift = (event) => fingers.delete(event.pointerId);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      drag(canvas, event);
      redraw();
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, lift);
    // Without Ctrl the wheel scrolls the page, which has many pictures in the way.
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      const far = Math.min(MOST_WHEEL, Math.max(-MOST_WHEEL, event.deltaY));
      enlarge(canvas, Math.exp(-WHEEL * far), [event.offsetX, event.offsetY]);
      redraw();
    }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => { reset(); redraw(); });
  }

  return { axes, fit, attach, reset };
}
