"use strict";
// Plots as SVG: axes with ticks, lines and bands over time, dots and boxes by category. A new drawing replaces the old.
const Plot = (() => {
  const NS = "http://www.w3.org/2000/svg", MARGIN = { left: 58, right: 12, top: 10, bottom: 40 };
  function add(parent, tag, attributes = {}, text) {
    const node = document.createElementNS(NS, tag);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    parent.append(node);
    return node;
  }
  function listTicks(low, high, most) { // multiples of 1, 2 or 5 times a power of ten
    const need = (high - low) / most, decade = 10 ** Math.floor(Math.log10(need));
    const step = decade * [1, 2, 5, 10].find((factor) => decade * factor >= need * 0.999), ticks = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
    return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }
  const number = (value, digits) => (value < -1e-12 ? "−" : "") + Math.abs(value).toFixed(digits);
  // A frame with both axes; x is a range or a list of categories.
  function frame(node, { x, y, xLabel = "", yLabel, height = 300 }) {
    const width = Math.max(260, node.clientWidth || 600), right = width - MARGIN.right, bottom = height - MARGIN.bottom;
    node.replaceChildren();
    const svg = add(node, "svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": yLabel });
    const [low, high] = y, Y = (value) => bottom - ((value - low) / (high - low)) * (bottom - MARGIN.top);
    const spans = typeof x[0] === "number", inner = right - MARGIN.left;
    const X = spans ? (value) => MARGIN.left + ((value - x[0]) / (x[1] - x[0])) * inner : (k, share = 0.5) => MARGIN.left + ((k + share) / x.length) * inner;
    const axes = add(svg, "g", { class: "axes" }), across = listTicks(low, high, height / 45);
    for (const value of across.ticks) {
      add(axes, "line", { x1: MARGIN.left, x2: right, y1: Y(value), y2: Y(value), class: "grid" });
      add(axes, "text", { x: MARGIN.left - 8, y: Y(value) + 4, "text-anchor": "end" }, number(value, across.digits));
    }
    if (spans) {
      const along = listTicks(x[0], x[1], width / 80);
      for (const value of along.ticks) {
        add(axes, "line", { x1: X(value), x2: X(value), y1: MARGIN.top, y2: bottom, class: "grid" });
        add(axes, "text", { x: X(value), y: bottom + 16, "text-anchor": "middle" }, number(value, along.digits));
      }
    } else {
      const room = inner / x.length / 7; // letters
      x.forEach((name, k) => add(axes, "text", { x: X(k), y: bottom + 16, "text-anchor": "middle" }, name.length > room ? name.slice(0, room - 1) + "…" : name));
    }
    add(axes, "text", { x: MARGIN.left + inner / 2, y: height - 6, "text-anchor": "middle", class: "label" }, xLabel);
    add(axes, "text", { transform: `translate(14 ${(MARGIN.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle", class: "label" }, yLabel);
    if (low < 0 && high > 0) add(axes, "line", { x1: MARGIN.left, x2: right, y1: Y(0), y2: Y(0), class: "zero" });
    const inside = (value) => Math.min(bottom, Math.max(MARGIN.top, Y(value)));
    return { svg, X, Y: inside, top: MARGIN.top, bottom, left: MARGIN.left, right, invert: (px) => x[0] + ((px - MARGIN.left) / inner) * (x[1] - x[0]) };
  }
  const path = (points) => points.map(([x, y], k) => `${k ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
  function line(plot, xs, ys, attributes) {
    return add(plot.svg, "path", { d: path(xs.map((x, k) => [plot.X(x), plot.Y(ys[k])])), fill: "none", ...attributes });
  }
  function band(plot, xs, lows, highs, attributes) { // a staircase: a value holds until the next one
    const steps = (values) => xs.flatMap((x, k) => [[plot.X(x), plot.Y(values[k])], [plot.X(xs[k + 1] ?? x), plot.Y(values[k])]]);
    return add(plot.svg, "path", { d: path([...steps(highs), ...steps(lows).reverse()]) + "Z", stroke: "none", ...attributes });
  }
  function quantile(sorted, share) {
    const place = share * (sorted.length - 1), k = Math.floor(place);
    return sorted[k] + (place - k) * ((sorted[k + 1] ?? sorted[k]) - sorted[k]);
  }
  // A box of quartiles and median under one dot per value; texts are shown when a dot is pointed at.
  function box(plot, middle, half, values, texts, color) {
    const group = add(plot.svg, "g", { class: "boxes" }), sorted = [...values].sort((a, b) => a - b);
    const [low, mid, high] = [0.25, 0.5, 0.75].map((share) => plot.Y(quantile(sorted, share)));
    add(group, "rect", { x: middle - half, width: 2 * half, y: high, height: Math.max(1, low - high), fill: color, "fill-opacity": 0.12, stroke: color });
    add(group, "line", { x1: middle - half, x2: middle + half, y1: mid, y2: mid, stroke: color, "stroke-width": 2 });
    values.forEach((value, k) => {
      const offset = (((k * 0.618034) % 1) - 0.5) * 1.4 * half; // spread evenly, the same at every drawing
      add(group, "circle", { cx: middle + offset, cy: plot.Y(value), r: 3, fill: color, "fill-opacity": 0.6, "data-tip": texts[k] });
    });
  }
  // Say what a dot is where a mouse points at it or a finger touches it.
  function explain(root) {
    const tip = Object.assign(document.createElement("div"), { className: "tip", hidden: true });
    document.body.append(tip);
    const show = (event) => {
      const text = event.target.dataset && event.target.dataset.tip;
      tip.hidden = !text;
      if (!text) return;
      tip.textContent = text;
      tip.style.left = `${Math.min(event.pageX + 10, document.documentElement.clientWidth - tip.offsetWidth - 8)}px`;
      tip.style.top = `${event.pageY - 34}px`;
    };
    root.addEventListener("pointerover", show);
    root.addEventListener("pointerdown", show);
  }
  return { add, frame, line, band, box, explain, listTicks };
})();
