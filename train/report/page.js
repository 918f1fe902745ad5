"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const robotColors = ["#0072b2", "#009e73", "#9456a0", "#56b4e9"], objectColors = ["#e69f00", "#a6761d", "#f0c83c"];
  const fade = 2.0; // [s] for which a fresh impact is drawn larger
  const state = { scenario: null, suite: null, hidden: new Set(), t: 0, playing: false, last: 0, panels: [] };

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
    const scale = Math.min((width - 2 * margin) / (x1 - x0), (panel.tall || Math.min(520, 0.58 * window.innerHeight)) / (y1 - y0));
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
    for (const [body, points] of Object.entries(replay.plan === null ? {} : data.plans[replay.plan].curves)) {
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
  function star(pen, x, y, reach, opacity) {
    pen.beginPath();
    for (let k = 0; k < 10; k++) {
      const r = k % 2 ? 0.42 * reach : reach, angle = (Math.PI * k) / 5 - Math.PI / 2;
      pen.lineTo(x + r * Math.cos(angle), y + r * Math.sin(angle));
    }
    pen.closePath();
    pen.lineWidth = 2.5; pen.strokeStyle = css("--world"); pen.stroke(); pen.fillStyle = css("--impact");
    pen.globalAlpha = opacity; pen.fill(); pen.globalAlpha = 1;
  }
  function drawImpacts(pen, panel, t) {
    const { view, replay } = panel, past = replay.impacts.filter((impact) => impact.time <= t + 1e-9);
    for (const impact of past) {
      const fresh = Math.max(0, 1 - (t - impact.time) / fade), reach = 5 + 6 * fresh;
      star(pen, view.x(impact.point[0]), view.y(impact.point[1]), reach, 0.65 + 0.35 * fresh);
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
  const isNumber = (value) => value !== null && Number.isFinite(value);
  function spread(values, least = 0.05) { // a range with zero and some room around
    const low = Math.min(0, ...values), high = Math.max(0, ...values), room = 0.08 * Math.max(high - low, least);
    return [low - room, high + room];
  }
  function drawBounds() { // the monitor's interval as a band, the robustness with the state held as a line
    const replays = state.panels.map((panel) => panel.replay), last = (pair) => pair.filter(isNumber);
    const seen = replays.flatMap((r) => [...r.held.robustness, ...r.bounds.map((pair) => pair[1]).filter(isNumber), ...last(r.bounds.at(-1))]);
    const y = spread(seen.length ? seen : [1]);
    const plot = Plot.frame(byId("bounds"), { x: [0, horizon()], y, xLabel: "time [s]", yLabel: "robustness [m]", height: 280 });
    for (const replay of replays) {
      const side = (k, other) => replay.bounds.map((pair) => (isNumber(pair[k]) ? pair[k] : other));
      Plot.band(plot, replay.times, side(0, y[0]), side(1, y[1]), { class: "band", fill: replay.color, "fill-opacity": 0.1 });
    }
    for (const replay of replays) {
      Plot.line(plot, replay.held.times, replay.held.robustness, { class: "held", stroke: replay.color, "stroke-width": 2.2 });
    }
    state.cursor = Plot.add(plot.svg, "line", { class: "cursor", y1: plot.top, y2: plot.bottom });
    state.plot = plot;
    plot.svg.addEventListener("pointerdown", (event) => {
      const t = plot.invert(event.clientX - plot.svg.getBoundingClientRect().left);
      if (t >= 0 && t <= horizon()) { seek(t); remember(); }
    });
    moveCursor();
  }
  function moveCursor() {
    if (!state.plot) return;
    const x = state.plot.X(state.t);
    state.cursor.setAttribute("x1", x); state.cursor.setAttribute("x2", x);
  }

  // ---- the plan, and the policy's learning ------------------------------------------------------------------------
  function drawPlans() {
    for (const canvas of document.querySelectorAll("canvas.plan")) {
      const replay = data.replays.find((r) => r.scenario === canvas.dataset.scenario && r.plan !== null);
      canvas.hidden = canvas.nextElementSibling.hidden = !replay;
      if (!replay) continue;
      const panel = { replay, canvas, colors: bodyColors(replay), tall: 300 }, plan = data.plans[replay.plan];
      fit(panel);
      const pen = canvas.getContext("2d"), view = panel.view;
      pen.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
      drawWorld(pen, panel);
      pen.lineJoin = pen.lineCap = "round";
      for (const [body, points] of Object.entries(plan.curves)) {
        pen.lineWidth = 2.2; pen.strokeStyle = panel.colors[body] || css("--muted"); trace(pen, view, points); pen.stroke();
      }
      drawBodies(pen, panel, 0);
      plan.impacts.forEach((impact, k) => {
        star(pen, view.x(impact.x), view.y(impact.y), 7, 1);
        write(pen, `${k + 1}`, view.x(impact.x) + 12, view.y(impact.y) - 8, css("--impact"), "center", view.width);
      });
      canvas.dataset.impacts = plan.impacts.length;
    }
  }
  function drawLearning() {
    data.learning.forEach((curve, k) => {
      const node = byId(`learning-${k}`), xs = curve.steps, y = spread([...curve.gain, ...curve.low], 0.001);
      const plot = Plot.frame(node, { x: [0, Math.max(1, xs.at(-1))], y, xLabel: "corrections answered", yLabel: "gain over the expert [m]", height: 240 });
      Plot.line(plot, xs, curve.low, { class: "learning", stroke: curve.color, "stroke-dasharray": "4 3" });
      Plot.line(plot, xs, curve.gain, { class: "learning", stroke: curve.color, "stroke-width": 2 });
    });
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
    drawTicks();
    seek(Math.min(state.t, horizon()));
    drawBounds();
  }
  function drawTicks() { // impacts under the slider, whose knob stays 8 pixels inside its ends
    byId("ticks").replaceChildren(...state.panels.flatMap(({ replay }) => replay.impacts.map((impact) => {
      const text = `impact at ${impact.time.toFixed(1)} s (${replay.name})`;
      const tick = element("button", { type: "button", title: text }), share = impact.time / horizon();
      tick.setAttribute("aria-label", text);
      tick.style.left = `calc(8px + ${share} * (100% - 16px))`; tick.style.background = replay.color;
      tick.onclick = () => { seek(impact.time); remember(); };
      return tick;
    })));
  }
  function seek(t) {
    state.t = Math.min(Math.max(0, t), horizon());
    byId("time").value = state.t;
    byId("clock").textContent = `${state.t.toFixed(1)} / ${horizon().toFixed(1)} s`;
    state.panels.forEach(drawPanel); moveCursor();
  }
  function remember() {
    const hash = new URLSearchParams({ scenario: state.scenario, suite: state.suite, t: state.t.toFixed(2) });
    history.replaceState(null, "", "#" + hash);
  }
  function readHash() {
    const hash = new URLSearchParams(location.hash.slice(1)), t = parseFloat(hash.get("t"));
    const names = unique(data.replays.map((r) => r.scenario)), name = hash.get("scenario");
    state.t = Number.isFinite(t) ? Math.max(0, t) : 0;
    choose(names.includes(name) ? name : names[0], hash.get("suite"));
  }
  function play(on) {
    state.playing = on; byId("play").textContent = on ? "Pause" : "Play";
    if (!on) { remember(); return; }
    if (state.t >= horizon() - 1e-9) seek(0);
    state.last = performance.now(); requestAnimationFrame(tick);
  }
  function tick(now) {
    if (!state.playing) return;
    seek(state.t + (Math.max(0, now - state.last) / 1000) * Number(byId("speed").value));
    state.last = now;
    if (state.t >= horizon()) play(false); else requestAnimationFrame(tick);
  }
  function startReplay() {
    if (!data.replays.length) return;
    byId("scenario").onchange = (event) => { play(false); state.t = 0; choose(event.target.value, state.suite); remember(); };
    byId("suite").onchange = (event) => { choose(state.scenario, event.target.value); remember(); };
    byId("time").oninput = (event) => seek(Number(event.target.value));
    byId("time").onchange = remember;
    byId("play").onclick = () => play(!state.playing);
    window.addEventListener("hashchange", readHash);
    readHash();
  }

  // ---- distributions ----------------------------------------------------------------------------------------------
  function drawDistribution(block, k) {
    const suites = unique(block.cells.map((cell) => cell.suite)), near = byId("near").checked;
    const all = block.cells.flatMap((cell) => cell.robustness), best = 1.25 * Math.max(0.05, ...all);
    const plot = Plot.frame(byId(`distribution-${k}`), { x: suites, y: near ? [-best, best] : spread(all), yLabel: "robustness [m]" });
    const count = data.policies.length, half = Math.min(26, (0.36 * (plot.X(1) - plot.X(0))) / count);
    data.policies.forEach((policy, place) => {
      for (const cell of block.cells.filter((one) => one.policy === policy.label)) {
        const texts = cell.robustness.map((value, n) => `${policy.name}, seed ${cell.seed[n]}: ${signed(value)} m`);
        Plot.box(plot, plot.X(suites.indexOf(cell.suite), (place + 0.5 + (count - 1) * 0.1) / (count * 1.2)), half, cell.robustness, texts, policy.color);
      }
    });
  }

  function drawStill() { data.distributions.forEach(drawDistribution); drawPlans(); drawLearning(); }
  function drawAll() { startReplay(); drawStill(); }
  byId("near").onchange = () => data.distributions.forEach(drawDistribution);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width) return; // a telephone's address bar comes and goes
    width = window.innerWidth; state.panels.forEach(fit); state.panels.forEach(drawPanel); drawStill();
    if (data.replays.length) drawBounds();
  });
  Plot.explain(document.body);
  try { drawAll(); document.body.dataset.ready = "true"; } catch (error) { document.body.dataset.error = String(error); throw error; }
})();
