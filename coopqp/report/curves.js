"use strict";
// Draws the figures when they are seen, with the playback's time as a line in each, hides and shows
// controllers, and fits the figures to the paper.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const boxes = [...document.querySelectorAll(".legend input")];
  const folds = [...document.querySelectorAll("details")];
  const playback = document.getElementById("playback");
  const OPTIONS = { displayModeBar: false, responsive: true, scrollZoom: true };
  const PRINTED = 340; // px, half a page between its margins
  // A finger that drags shall scroll the page.
  const dragmode = window.matchMedia("(pointer: coarse)").matches ? false : "zoom";
  const cursors = new Map(); // of the plots that are drawn and have a time

  function place(plot) {
    const cursor = cursors.get(plot), { xaxis, yaxis } = plot._fullLayout;
    const x = xaxis.l2p(Number(playback.dataset.time));
    cursor.hidden = !(x > -1 && x < xaxis._length + 1);
    cursor.style.left = `${xaxis._offset + x}px`;
    cursor.style.top = `${yaxis._offset}px`;
    cursor.style.height = `${yaxis._length}px`;
  }

  function draw(plot) {
    const { data, layout, overTime } = figures[plots.indexOf(plot)];
    const visible = (line) => boxes.every((box) =>
      box.checked || box.dataset.controller !== line.legendgroup);
    for (const line of data) line.visible = visible(line);
    Plotly.newPlot(plot, data, { ...layout, dragmode }, OPTIONS);
    // Without Ctrl the wheel scrolls the page.
    plot.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) event.stopPropagation();
    }, { capture: true, passive: true });
    if (!overTime) return;
    const cursor = document.createElement("div");
    cursor.className = "cursor";
    plot.append(cursor);
    cursors.set(plot, cursor);
    place(plot);
    plot.on("plotly_afterplot", () => place(plot));
    plot.on("plotly_click", ({ points }) =>
      playback.dispatchEvent(new CustomEvent("seek", { detail: points[0].x })));
  }

  // A plot that is folded away may have no size to draw it in.
  function drawSeen() {
    for (const plot of plots) if (!plot.data && !plot.closest("details:not([open])")) draw(plot);
  }

  function show(name, visible) {
    for (const box of boxes) if (box.dataset.controller === name) box.checked = visible;
    for (const plot of plots.filter((plot) => plot.data)) {
      const lines = plot.data.flatMap((line, i) => (line.legendgroup === name ? [i] : []));
      if (lines.length) Plotly.restyle(plot, { visible }, lines);
    }
  }
  for (const box of boxes)
    box.addEventListener("change", () => show(box.dataset.controller, box.checked));

  const fit = (layout) => plots.forEach((plot) => Plotly.relayout(plot, layout));
  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = folds.filter((fold) => !fold.open);
    for (const fold of opened) fold.open = true;
    drawSeen();
    fit({ width: PRINTED, autosize: false });
  });
  window.addEventListener("afterprint", () => {
    fit({ width: null, autosize: true });
    for (const fold of opened) fold.open = false;
  });
  for (const fold of folds) fold.addEventListener("toggle", drawSeen);
  playback.addEventListener("time", () => cursors.forEach((_, plot) => place(plot)));
  drawSeen();
})();
