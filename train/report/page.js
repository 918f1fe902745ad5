"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const robotColors = ["#0072b2", "#009e73", "#9456a0", "#56b4e9"], objectColors = ["#e69f00", "#a6761d", "#f0c83c"];
  const fade = 2.0; // [s] for which a fresh impact is drawn larger
  const state = { scenario: null, suite: null, hidden: new Set(), t: 0, playing: false, last: 0, panels: [], chart: 0 };

  // ---- interpolation ------------------------------------------------------------------------------------------
  function locate(times, t) { // last index with times[k] <= t, and the share of the step behind it
    let low = 0, high = times.length - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (times[mid] <= t) low = mid; else high = mid; }
    const span = times[high] - times[low];
    return [low, span > 0 ? Math.min(1, Math.max(0, (t - times[low]) / span)) : 0];
  }
  function pose(replay, body, t) {
    const [k, s] = locate(replay.times, t), track = replay.tracks[body], n = Math.min(k + 1, track.x.length - 1);
    const turn = track.heading[n] - track.heading[k];
    return {
      x: track.x[k] + s * (track.x[n] - track.x[k]),
      y: track.y[k] + s * (track.y[n] - track.y[k]),
      heading: track.heading[k] + s * Math.atan2(Math.sin(turn), Math.cos(turn)), // the short way round
    };
  }
  function bounds(replay, t) { // a staircase: the monitor's interval holds until the next sample
    const [k, s] = locate(replay.times, t);
    return replay.bounds[s >= 1 ? Math.min(k + 1, replay.bounds.length - 1) : k];
  }
  const signed = (value) => (value === null ? "?" : (value >= 0 ? "+" : "−") + Math.abs(value).toFixed(3));
  const verdict = ([low, high]) => (low !== null && low > 0 ? "satisfied" : high !== null && high < 0 ? "violated" : "undecided");

  // ---- one canvas per policy ----------------------------------------------------------------------------------
  function bodyColors(replay) {
    const colors = {}; let robots = 0, objects = 0;
    for (const body of replay.bodies) {
      const robot = replay.shapes.some((shape) => shape.body === body && shape.role === "robot");
      colors[body] = robot ? robotColors[robots++ % robotColors.length] : objectColors[objects++ % objectColors.length];
    }
    return colors;
  }
  function fit(panel) { // one scale for both axes; the world is centred
    const [[x0, y0], [x1, y1]] = panel.replay.world, margin = 10;
    const width = panel.canvas.clientWidth || 320;
    const scale = Math.min((width - 2 * margin) / (x1 - x0), 520 / (y1 - y0));
    const height = Math.round(scale * (y1 - y0) + 2 * margin), ratio = window.devicePixelRatio || 1;
    panel.canvas.style.aspectRatio = `${width} / ${height}`; // keeps its shape where a printer makes it narrower
    panel.canvas.width = Math.round(width * ratio); panel.canvas.height = Math.round(height * ratio);
    const left = (width - scale * (x1 - x0)) / 2;
    panel.view = { scale, ratio, width, height, x: (x) => left + scale * (x - x0), y: (y) => height - margin - scale * (y - y0) };
  }
  function trace(pen, view, points) {
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(view.x(x), view.y(y)) : pen.moveTo(view.x(x), view.y(y))));
  }
  function outline(pen, view, shape, at) {
    if (shape.vertices === null) {
      pen.beginPath(); pen.arc(view.x(at.x), view.y(at.y), view.scale * shape.radius, 0, 2 * Math.PI); return;
    }
    const c = Math.cos(at.heading), s = Math.sin(at.heading);
    trace(pen, view, shape.vertices.map(([x, y]) => [at.x + c * x - s * y, at.y + s * x + c * y]));
    pen.closePath();
  }
  function write(pen, text, x, y, color, align, width) {
    pen.font = "12px system-ui, sans-serif"; pen.textAlign = align; pen.textBaseline = "top";
    const half = pen.measureText(text).width / 2;
    if (align === "center") x = Math.min(Math.max(x, half + 2), width - half - 2);
    pen.lineWidth = 3; pen.lineJoin = "round"; pen.strokeStyle = css("--world"); pen.strokeText(text, x, y);
    pen.fillStyle = color; pen.fillText(text, x, y);
  }
  function labelArea(pen, { view, replay }, shape) { // in the upper left corner; upright where the area is too narrow
    const [[x0, y0], [x1, y1]] = replay.world, xs = shape.vertices.map((v) => v[0]), ys = shape.vertices.map((v) => v[1]);
    const left = view.x(Math.max(Math.min(...xs), x0)), top = view.y(Math.min(Math.max(...ys), y1));
    const room = view.x(Math.min(Math.max(...xs), x1)) - left;
    pen.save(); pen.font = "12px system-ui, sans-serif"; pen.textBaseline = "top"; pen.textAlign = "left";
    pen.fillStyle = css((shape.role === "region" ? "--region" : "--solid") + "-ink"); pen.translate(left + 5, top + 4);
    if (pen.measureText(shape.label).width + 8 > room) { pen.rotate(Math.PI / 2); pen.translate(0, -14); }
    pen.fillText(shape.label, 0, 0); pen.restore();
  }
  function drawWorld(pen, panel) {
    const view = panel.view, [[x0, y0], [x1, y1]] = panel.replay.world, fixed = { x: 0, y: 0, heading: 0 };
    pen.fillStyle = css("--world"); pen.fillRect(0, 0, view.width, view.height);
    pen.save(); pen.beginPath(); pen.rect(view.x(x0), view.y(y1), view.scale * (x1 - x0), view.scale * (y1 - y0)); pen.clip();
    const need = Math.max(x1 - x0, y1 - y0) / 12, decade = 10 ** Math.floor(Math.log10(need));
    const step = decade * [1, 2, 5, 10].find((factor) => decade * factor >= need);
    pen.strokeStyle = css("--grid"); pen.lineWidth = 1;
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) { trace(pen, view, [[x, y0], [x, y1]]); pen.stroke(); }
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) { trace(pen, view, [[x0, y], [x1, y]]); pen.stroke(); }
    const areas = panel.replay.shapes.filter((shape) => shape.body === null);
    for (const shape of [...areas].sort((a, b) => (b.role === "region") - (a.role === "region"))) {
      const kind = shape.role === "region" ? "--region" : "--solid";
      outline(pen, view, shape, fixed);
      pen.fillStyle = css(kind); pen.fill(); pen.strokeStyle = css(kind + "-edge"); pen.lineWidth = 1.5; pen.stroke();
    }
    pen.restore();
    pen.strokeStyle = css("--edge"); pen.lineWidth = 1;
    pen.strokeRect(view.x(x0), view.y(y1), view.scale * (x1 - x0), view.scale * (y1 - y0));
    for (const shape of areas.filter((area) => area.label && area.vertices)) labelArea(pen, panel, shape);
    write(pen, `grid ${step} m`, view.x(x1) - 4, view.y(y0) - 15, css("--muted"), "right", view.width);
  }
  function drawCurves(pen, panel, t) {
    const { view, replay, colors } = panel;
    pen.lineJoin = pen.lineCap = "round";
    for (const [body, points] of Object.entries(replay.plan)) {
      pen.setLineDash([6, 5]); pen.globalAlpha = 0.6; pen.lineWidth = 1.3; pen.strokeStyle = colors[body] || css("--muted");
      trace(pen, view, points); pen.stroke();
    }
    pen.setLineDash([]);
    for (const body of replay.bodies.filter((name) => replay.shapes.some((s) => s.body === name && s.label))) {
      const track = replay.tracks[body], [k] = locate(replay.times, t), now = pose(replay, body, t), points = [];
      for (let n = 0; n <= k; n++) points.push([track.x[n], track.y[n]]);
      points.push([now.x, now.y]);
      pen.globalAlpha = 0.75; pen.lineWidth = 2.2; pen.strokeStyle = colors[body]; trace(pen, view, points); pen.stroke();
    }
    pen.globalAlpha = 1;
  }
  function placeJoints({ base, lengths: [upper, lower, hand], elbow }, at) { // base, elbow, wrist, pad
    const wrist = [at.x - hand * Math.cos(at.heading), at.y - hand * Math.sin(at.heading)];
    const dx = wrist[0] - base[0], dy = wrist[1] - base[1];
    const cosine = (dx * dx + dy * dy - upper * upper - lower * lower) / (2 * upper * lower);
    const bend = elbow * Math.acos(Math.min(1, Math.max(-1, cosine)));
    const first = Math.atan2(dy, dx) - Math.atan2(lower * Math.sin(bend), upper + lower * Math.cos(bend));
    return [base, [base[0] + upper * Math.cos(first), base[1] + upper * Math.sin(first)], wrist, [at.x, at.y]];
  }
  function drawLinks(pen, panel, t) {
    const { view, replay, colors } = panel;
    for (const [body, arm] of Object.entries(replay.links || {})) {
      const joints = placeJoints(arm, pose(replay, body, t));
      pen.lineJoin = pen.lineCap = "round"; pen.globalAlpha = 0.55; pen.lineWidth = 6; pen.strokeStyle = colors[body];
      trace(pen, view, joints); pen.stroke(); pen.globalAlpha = 1;
      pen.fillStyle = css("--world"); pen.strokeStyle = css("--ink"); pen.lineWidth = 1;
      for (const [x, y] of joints.slice(0, 3)) { pen.beginPath(); pen.arc(view.x(x), view.y(y), 3.5, 0, 2 * Math.PI); pen.fill(); pen.stroke(); }
    }
  }
  function drawBodies(pen, panel, t) {
    const { view, replay, colors } = panel, shown = [];
    for (const shape of replay.shapes.filter((s) => s.body !== null)) {
      const at = pose(replay, shape.body, t);
      outline(pen, view, shape, at);
      pen.fillStyle = colors[shape.body]; pen.globalAlpha = 0.88; pen.fill(); pen.globalAlpha = 1;
      pen.strokeStyle = css("--ink"); pen.lineWidth = 0.8; pen.stroke();
      if (shape.role === "robot" && shape.radius !== null) {
        const c = shape.radius * Math.cos(at.heading), s = shape.radius * Math.sin(at.heading);
        trace(pen, view, [[at.x + 0.25 * c, at.y + 0.25 * s], [at.x + 0.85 * c, at.y + 0.85 * s]]);
        pen.strokeStyle = "#ffffff"; pen.lineWidth = 2.2; pen.stroke();
      }
      const reach = shape.radius ?? Math.max(...shape.vertices.map(([x, y]) => Math.hypot(x, y)));
      if (shape.label) write(pen, shape.label, view.x(at.x), view.y(at.y) + view.scale * reach + 3, css("--ink"), "center", view.width);
      shown.push(`${shape.body}:${at.x.toFixed(3)},${at.y.toFixed(3)}`);
    }
    panel.canvas.dataset.pose = shown.join(" ");
  }
  function drawImpacts(pen, panel, t) {
    const { view, replay } = panel, past = replay.impacts.filter((impact) => impact.time <= t + 1e-9);
    for (const impact of past) {
      const fresh = Math.max(0, 1 - (t - impact.time) / fade), reach = 5 + 6 * fresh;
      pen.beginPath();
      for (let k = 0; k < 10; k++) {
        const r = k % 2 ? 0.42 * reach : reach, angle = (Math.PI * k) / 5 - Math.PI / 2;
        pen.lineTo(view.x(impact.point[0]) + r * Math.cos(angle), view.y(impact.point[1]) + r * Math.sin(angle));
      }
      pen.closePath();
      pen.lineWidth = 2.5; pen.strokeStyle = css("--world"); pen.stroke(); pen.fillStyle = css("--impact");
      pen.globalAlpha = 0.65 + 0.35 * fresh; pen.fill(); pen.globalAlpha = 1;
    }
    panel.canvas.dataset.impacts = past.length;
    return past.length;
  }
  function drawPanel(panel) {
    const pen = panel.canvas.getContext("2d"), replay = panel.replay, t = Math.min(state.t, replay.times.at(-1));
    pen.setTransform(panel.view.ratio, 0, 0, panel.view.ratio, 0, 0);
    drawWorld(pen, panel); drawCurves(pen, panel, t); drawLinks(pen, panel, t); drawBodies(pen, panel, t);
    const count = drawImpacts(pen, panel, t), interval = bounds(replay, t), word = verdict(interval);
    panel.canvas.dataset.time = t.toFixed(3); panel.canvas.dataset.bounds = interval.join(",");
    panel.verdict.textContent = word; panel.verdict.className = word;
    const over = t >= replay.times.at(-1) - 1e-9;
    panel.readout.textContent = (over ? `robustness ${signed(replay.robustness)} m` : `robustness in [${interval.map(signed).join(", ")}] m`)
      + ` · ${count} impact${count === 1 ? "" : "s"}`;
  }

  // ---- robustness still possible, over time ---------------------------------------------------------------------
  const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;"); // plotly reads some tags in names
  const rgba = (hex, alpha) => `rgba(${[1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)).join(",")},${alpha})`;
  function baseLayout(extra) {
    const axis = { gridcolor: css("--line"), zeroline: false, linecolor: css("--edge"), ticks: "outside", tickcolor: css("--line") };
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: css("--ink"), family: "system-ui, sans-serif", size: 12.5 },
      margin: { l: 64, r: 16, t: 12, b: 46 }, hovermode: "closest",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--edge"), activecolor: css("--accent") }, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      ...extra, xaxis: { ...axis, ...extra.xaxis }, yaxis: { ...axis, ...extra.yaxis },
    };
  }
  const zeroLine = () => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: 0, y1: 0, line: { color: css("--ink"), width: 1.2, dash: "dash" } });
  const options = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };
  function boundTraces(replay) { // the monitor's interval as a band, the robustness with the state held as a line
    const side = (k) => replay.bounds.map((pair) => pair[k]), color = replay.color, name = plain(replay.name);
    const edge = { x: replay.times, mode: "lines", line: { color, width: 0.8, shape: "hv", dash: "dot" }, showlegend: false, legendgroup: replay.label };
    const hover = (what) => ({ hovertemplate: `${what} %{y:.3f} m at %{x:.1f} s<extra>${name}</extra>` });
    return [
      { ...edge, ...hover("at least"), y: side(0) },
      { ...edge, ...hover("at most"), y: side(1), fill: "tonexty", fillcolor: rgba(color, 0.09) },
      { ...hover("if held"), x: replay.held.times, y: replay.held.robustness, name, legendgroup: replay.label, mode: "lines", line: { color, width: 2.2 } },
    ];
  }
  const cursor = () => ({ type: "line", yref: "paper", x0: state.t, x1: state.t, y0: 0, y1: 1, line: { color: css("--accent"), width: 1.5 } });
  function drawBounds() {
    const layout = baseLayout({
      xaxis: { title: { text: "time [s]" }, range: [0, horizon()] }, yaxis: { title: { text: "robustness [m]" } }, shapes: [zeroLine(), cursor()],
    });
    return Plotly.react("bounds", state.panels.flatMap((panel) => boundTraces(panel.replay)), layout, options);
  }
  function moveCursor(now) { // relayout is the slow part of a picture: 12 times a second will do
    if (!byId("bounds") || (state.playing && now - state.chart < 80)) return;
    state.chart = now;
    Plotly.relayout("bounds", { "shapes[1].x0": state.t, "shapes[1].x1": state.t });
  }

  // ---- choosing and playing -------------------------------------------------------------------------------------
  const chosen = () => data.replays.filter((r) => r.scenario === state.scenario && r.suite === state.suite);
  const horizon = () => Math.max(...chosen().map((r) => r.times.at(-1)));
  const unique = (values) => [...new Set(values)];
  function element(tag, attributes = {}, text = "") {
    const node = Object.assign(document.createElement(tag), attributes); node.textContent = text; return node;
  }
  function fill(select, values, value) {
    select.replaceChildren(...values.map((v) => element("option", { value: v, selected: v === value }, v)));
  }
  function makePanel(replay) {
    const figure = element("figure", { className: "panel" }), caption = element("figcaption");
    figure.style.setProperty("--policy", replay.color);
    const canvas = element("canvas"), word = element("span"), readout = element("small");
    canvas.dataset.policy = replay.label; canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Replay of ${replay.label} on ${replay.scenario}`);
    caption.append(word, element("strong", { title: replay.label }, replay.name), ` · seed ${replay.seed}`, readout);
    figure.append(caption, canvas); byId("panels").append(figure);
    return { replay, canvas, verdict: word, readout, colors: bodyColors(replay) };
  }
  function choose(scenario, suite) {
    const suites = unique(data.replays.filter((r) => r.scenario === scenario).map((r) => r.suite));
    state.scenario = scenario; state.suite = suites.includes(suite) ? suite : suites[0];
    fill(byId("scenario"), unique(data.replays.map((r) => r.scenario)), scenario); fill(byId("suite"), suites, state.suite);
    byId("policies").replaceChildren(...chosen().map((replay) => {
      const button = element("button", { type: "button", title: replay.label }, replay.name);
      button.prepend(Object.assign(element("i", { className: "swatch" }), { style: `background:${replay.color}` }));
      button.setAttribute("aria-pressed", String(!state.hidden.has(replay.label)));
      button.onclick = () => {
        if (!state.hidden.delete(replay.label)) state.hidden.add(replay.label);
        choose(state.scenario, state.suite);
      };
      return button;
    }));
    byId("time").max = horizon(); byId("panels").replaceChildren();
    state.panels = chosen().filter((replay) => !state.hidden.has(replay.label)).map(makePanel);
    state.panels.forEach(fit);
    seek(Math.min(state.t, horizon()));
    return drawBounds();
  }
  function seek(t) {
    state.t = Math.min(Math.max(0, t), horizon());
    byId("time").value = state.t;
    byId("clock").textContent = `${state.t.toFixed(1)} / ${horizon().toFixed(1)} s`;
    state.panels.forEach(drawPanel);
  }
  function remember() {
    const hash = new URLSearchParams({ scenario: state.scenario, suite: state.suite, t: state.t.toFixed(2) });
    history.replaceState(null, "", "#" + hash);
  }
  function readHash() {
    const hash = new URLSearchParams(location.hash.slice(1)), t = parseFloat(hash.get("t"));
    const names = unique(data.replays.map((r) => r.scenario)), name = hash.get("scenario");
    state.t = Number.isFinite(t) ? Math.max(0, t) : Infinity; // without a wish: the end, where the whole path shows
    return choose(names.includes(name) ? name : names[0], hash.get("suite"));
  }
  function play(on) {
    state.playing = on; byId("play").textContent = on ? "Pause" : "Play";
    if (!on) { remember(); moveCursor(Infinity); return; }
    if (state.t >= horizon() - 1e-9) seek(0);
    state.last = performance.now(); requestAnimationFrame(tick);
  }
  function tick(now) {
    if (!state.playing) return;
    seek(state.t + (Math.max(0, now - state.last) / 1000) * Number(byId("speed").value));
    state.last = now; moveCursor(now);
    if (state.t >= horizon()) play(false); else requestAnimationFrame(tick);
  }
  function startReplay() {
    if (!data.replays.length) return Promise.resolve();
    byId("scenario").onchange = (event) => { choose(event.target.value, state.suite); remember(); };
    byId("suite").onchange = (event) => { choose(state.scenario, event.target.value); remember(); };
    byId("time").oninput = (event) => { seek(Number(event.target.value)); moveCursor(performance.now()); };
    byId("time").onchange = remember;
    byId("play").onclick = () => play(!state.playing);
    window.addEventListener("hashchange", readHash);
    window.addEventListener("resize", () => { state.panels.forEach(fit); state.panels.forEach(drawPanel); });
    return readHash().then(() => {
      byId("bounds").on("plotly_click", (event) => { seek(event.points[0].x); moveCursor(performance.now()); remember(); });
    });
  }

  // ---- distributions ----------------------------------------------------------------------------------------------
  function drawDistribution(block, k) {
    const traces = data.policies.map((policy) => {
      const cells = block.cells.filter((cell) => cell.policy === policy.label);
      return {
        type: "box", name: plain(policy.name), x: cells.flatMap((c) => c.robustness.map(() => c.suite)), y: cells.flatMap((c) => c.robustness),
        text: cells.flatMap((c) => c.seed.map((seed) => `seed ${seed}`)), hovertemplate: "%{y:.3f} m, %{text}<extra>%{fullData.name}</extra>",
        boxpoints: "all", jitter: 0.5, pointpos: 0, marker: { color: policy.color, size: 4.5, opacity: 0.55 },
        line: { color: policy.color, width: 1.4 }, fillcolor: rgba(policy.color, 0.1), hoveron: "points",
      };
    });
    const layout = baseLayout({ boxmode: "group", yaxis: { title: { text: "robustness [m]" } }, shapes: [zeroLine()] });
    return Plotly.react(`distribution-${k}`, traces, layout, options);
  }
  function zoomDistributions(near) {
    data.distributions.forEach((block, k) => {
      const best = Math.max(...block.cells.flatMap((c) => c.robustness)), reach = 1.25 * Math.max(best, 0.05);
      Plotly.relayout(`distribution-${k}`, near ? { "yaxis.range": [-reach, reach] } : { "yaxis.autorange": true });
    });
  }

  function drawAll() { return Promise.all([startReplay(), ...data.distributions.map(drawDistribution)]); }
  byId("near").onchange = (event) => zoomDistributions(event.target.checked);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  drawAll().then(() => { document.body.dataset.ready = "true"; }, (error) => { document.body.dataset.error = String(error); throw error; });
})();
