"use strict";
// Draws the figures, hides and shows controllers, and fits the figures to the paper.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const OPTIONS = { displayModeBar: false, responsive: true };
  const PRINTED = 340; // px, half a page between its margins

  plots.forEach((plot, i) => Plotly.newPlot(plot, figures[i].data, figures[i].layout, OPTIONS));

  const boxes = [...document.querySelectorAll(".legend input")];
  function show(name, visible) {
    for (const box of boxes) if (box.dataset.controller === name) box.checked = visible;
    for (const plot of plots) {
      const lines = plot.data.flatMap((line, i) => (line.legendgroup === name ? [i] : []));
      if (lines.length) Plotly.restyle(plot, { visible }, lines);
    }
  }
  for (const box of boxes)
    box.addEventListener("change", () => show(box.dataset.controller, box.checked));

  const fit = (layout) => plots.forEach((plot) => Plotly.relayout(plot, layout));
  window.addEventListener("beforeprint", () => fit({ width: PRINTED, autosize: false }));
  window.addEventListener("afterprint", () => fit({ width: null, autosize: true }));
})();
