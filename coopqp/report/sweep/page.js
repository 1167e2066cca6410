"use strict";
// Draws what bins.py has counted; nothing here grows with the number of rows.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const byId = (id) => document.getElementById(id);
  const make = (parent, name, attributes = {}, text = "") => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== "") node.textContent = text;
    parent.appendChild(node);
    return node;
  };
  const drawing = (parent, width, height, label) =>
    make(parent, "svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  const short = (x) => (x === null ? "left out" : x === 0 ? "0" : Math.abs(x) < 1e-3 || Math.abs(x) >= 1e5 ? x.toExponential(1) : String(+x.toPrecision(3)));
  const bins = (axis) => axis.labels.length || axis.edges.length - 1;
  // Without its middle: names often differ at their ends.
  const clipped = (text, most) => {
    const head = Math.ceil((most - 1) / 2);
    return text.length > most ? text.slice(0, head) + "…" + text.slice(text.length - (most - 1 - head)) : text;
  };
  // From sand, none succeeds, to dark brown, all do: ever darker, and no controller's colour.
  const mix = (a, b, t) => a.map((x, i) => Math.round(x + t * (b[i] - x)));
  const color = (share) => {
    const low = [240, 228, 194], middle = [165, 132, 86], high = [52, 36, 14];
    const c = share < 0.5 ? mix(low, middle, 2 * share) : mix(middle, high, 2 * share - 1);
    return `rgb(${c})`;
  };
  const ticks = (axis, length, step, most = 12) => {
    // Places along an axis, as shares of it, with their words.
    const n = bins(axis);
    const every = Math.max(1, Math.ceil(n * step / length));
    const found = [];
    if (axis.labels.length) {
      for (let k = 0; k < n; k += every) found.push([(k + 0.5) / n, clipped(axis.labels[k], most)]);
    } else {
      const apart = Math.max(every, n / 4);
      for (let k = 0; k <= n; k += apart) found.push([k / n, short(axis.edges[Math.round(k)])]);
    }
    return found;
  };
  const options = (select, names) => names.forEach((name, k) => select.add(new Option(name, k)));

  const drawMaps = () => {
    const host = byId("maps"), i = +byId("across").value, j = +byId("up").value;
    host.replaceChildren();
    const turned = i > j;
    const map = study.maps.find((m) => m.x === Math.min(i, j) && m.y === Math.max(i, j));
    if (!map) return;
    const x = study.axes[i], y = study.axes[j], nx = bins(x), ny = bins(y);
    const W = 400, H = 330, left = 62, top = 26, right = 22, bottom = 44;
    const w = (W - left - right) / nx, h = (H - top - bottom) / ny;
    study.controllers.forEach((name, k) => {
      const svg = drawing(host, W, H, `success of ${name}`);
      make(svg, "text", { x: left, y: 16, class: "title", fill: study.colors[k] }, clipped(name, 40));
      for (let a = 0; a < nx; a++) for (let b = 0; b < ny; b++) {
        const cell = turned ? b * nx + a : a * ny + b;
        const all = map.all[k][cell], good = map.good[k][cell];
        if (!all) continue;
        const box = make(svg, "rect", { x: left + a * w, y: top + (ny - 1 - b) * h, width: w + 0.4, height: h + 0.4, fill: color(good / all) });
        make(box, "title", {}, `${good} of ${all} succeed`);
      }
      make(svg, "rect", { x: left, y: top, width: nx * w, height: ny * h, fill: "none", stroke: "#aeb6bd" });
      for (const [at, word] of ticks(x, W - left - right, 52)) make(svg, "text", { x: left + at * nx * w, y: H - bottom + 15, "text-anchor": "middle" }, word);
      for (const [at, word] of ticks(y, H - top - bottom, 18)) make(svg, "text", { x: left - 6, y: top + (1 - at) * ny * h + 4, "text-anchor": "end" }, word);
      make(svg, "text", { x: left + nx * w / 2, y: H - 8, "text-anchor": "middle" }, x.name);
      make(svg, "text", { x: 12, y: top + ny * h / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${top + ny * h / 2})` }, y.name);
    });
  };

  const drawBands = () => {
    const host = byId("curves"), measure = byId("measure").value;
    host.replaceChildren();
    const logarithm = measure !== study.margin;
    const f = (v) => (logarithm ? Math.log10(Math.max(v, 1e-12)) : v);
    const all = study.bands[measure].flat(2).filter(Boolean).flat().map(f).filter(Number.isFinite);
    if (!all.length) return;
    // One scale for all; what is far out of it runs to its edge.
    let low = Math.min(...all), high = Math.max(...all);
    if (high - low < 1e-9) { low -= 0.5; high += 0.5; }
    const W = 560, H = 230, left = 74, top = 10, right = 26, bottom = 42;
    study.axes.forEach((axis, i) => {
      const n = bins(axis), svg = drawing(host, W, H, `${measure} by ${axis.name}`);
      const px = (k) => left + (k + 0.5) / n * (W - left - right);
      const py = (v) => top + (high - Math.min(high, Math.max(low, f(v)))) / (high - low) * (H - top - bottom);
      for (let t = 0; t <= 4; t++) {
        const v = low + (high - low) * t / 4, yy = top + (1 - t / 4) * (H - top - bottom);
        make(svg, "line", { x1: left, x2: W - right, y1: yy, y2: yy, stroke: "#e6e9ec" });
        make(svg, "text", { x: left - 6, y: yy + 4, "text-anchor": "end" }, short(logarithm ? 10 ** v : v));
      }
      study.controllers.forEach((name, k) => {
        const found = study.bands[measure][i][k];
        const known = found.map((q, b) => [q, b]).filter(([q]) => q);
        const area = (lo, hi, opacity) => {
          const up = known.map(([q, b]) => `${px(b)},${py(q[hi])}`), down = known.map(([q, b]) => `${px(b)},${py(q[lo])}`).reverse();
          make(svg, "polygon", { points: [...up, ...down].join(" "), fill: study.colors[k], opacity });
        };
        area(0, 4, 0.12);
        area(1, 3, 0.2);
        make(svg, "polyline", { points: known.map(([q, b]) => `${px(b)},${py(q[2])}`).join(" "), fill: "none", stroke: study.colors[k], "stroke-width": study.widths[k], "stroke-dasharray": study.dashes[k] || "none" });
        if (axis.labels.length) known.forEach(([q, b]) => make(svg, "circle", { cx: px(b), cy: py(q[2]), r: 3, fill: study.colors[k] }));
      });
      for (const [at, word] of ticks(axis, W - left - right, 60)) make(svg, "text", { x: left + at * (W - left - right), y: H - bottom + 16, "text-anchor": "middle" }, word);
      make(svg, "text", { x: left + (W - left - right) / 2, y: H - 7, "text-anchor": "middle", class: "title" }, axis.name);
      make(svg, "text", { x: 12, y: top + (H - top - bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${top + (H - top - bottom) / 2})` }, "m or rad");
    });
  };

  const drawFlows = () => {
    const sides = [{ name: "controller", labels: study.controllers, edges: [] }, ...study.axes, { name: "success", labels: ["no", "yes"], edges: [] }];
    const W = Math.max(900, 150 * sides.length), H = 380, top = 34, bottom = 16, margin = 60;
    const svg = drawing(byId("ribbons"), W, H, "parallel coordinates");
    const px = (s) => margin + s / (sides.length - 1) * (W - 2 * margin);
    const py = (s, b) => top + (1 - (b + 0.5) / bins(sides[s])) * (H - top - bottom);
    study.flows.forEach((flow, s) => {
      const most = Math.max(...flow.map((f) => f[2]));
      // The rare ones on top, so that they show.
      [...flow].sort((a, b) => b[2] - a[2]).forEach(([a, b, all, good]) => {
        const x1 = px(s) + 4, x2 = px(s + 1) - 4, y1 = py(s, a), y2 = py(s + 1, b), c = (x2 - x1) / 2;
        const line = make(svg, "path", { d: `M${x1},${y1}C${x1 + c},${y1} ${x2 - c},${y2} ${x2},${y2}`, fill: "none", stroke: color(good / all), "stroke-width": (0.6 + 9 * all / most).toFixed(2), opacity: 0.55 });
        make(line, "title", {}, `${good} of ${all} succeed`);
      });
    });
    sides.forEach((side, s) => {
      make(svg, "line", { x1: px(s), x2: px(s), y1: top, y2: H - bottom, stroke: "#5a646d" });
      make(svg, "text", { x: px(s), y: 18, "text-anchor": "middle", class: "title" }, clipped(side.name, 22));
      for (const [at, word] of ticks(side, H - top - bottom, 16, 17)) {
        const label = make(svg, "text", { x: px(s) + 6, y: top + (1 - at) * (H - top - bottom) + 4, stroke: "#fff", "stroke-width": 3, "paint-order": "stroke" }, word);
        if (s === sides.length - 1) { label.setAttribute("x", px(s) - 6); label.setAttribute("text-anchor", "end"); }
      }
    });
  };

  // A figure that cannot be drawn is replaced by words.
  const drawn = (host, draw) => () => {
    try { draw(); } catch (error) { byId(host).replaceChildren(`This figure could not be drawn (${error.message}).`); }
  };
  const showMaps = drawn("maps", drawMaps), showBands = drawn("curves", drawBands), showFlows = drawn("ribbons", drawFlows);

  if (study.maps.length) {
    byId("map").hidden = false;
    const names = study.axes.map((axis) => axis.name);
    const across = byId("across"), up = byId("up");
    options(across, names);
    options(up, names);
    up.value = String(Math.min(1, names.length - 1));
    // Each pair once; who chooses the same twice gets the other one turned.
    const chosen = (one, other) => () => {
      if (names.length > 1 && one.value === other.value) other.value = String((+one.value + 1) % names.length);
      showMaps();
    };
    across.addEventListener("change", chosen(across, up));
    up.addEventListener("change", chosen(up, across));
    const scale = byId("scale");
    scale.append("none succeeds ");
    for (let t = 0; t <= 6; t++) {
      const patch = document.createElement("i");
      patch.style.background = color(t / 6);
      scale.append(patch);
    }
    scale.append(" all do; white: no rows");
    showMaps();
  }
  if (study.axes.length) {
    byId("bands").hidden = false;
    const names = Object.keys(study.bands);
    names.forEach((name) => byId("measure").add(new Option(name, name)));
    byId("measure").addEventListener("change", showBands);
    showBands();
    if (study.flows.every((flow) => flow.length)) {
      byId("flows").hidden = false;
      showFlows();
    }
  }
})();
