"use strict";
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const dashes = ["solid", "dash", "dot"];
  const colourOf = (index) => figures.colours[index % figures.colours.length];
  const dashOf = (index) => dashes[Math.floor(index / figures.colours.length) % dashes.length];
  const places = new Map(figures.policies.map((name, index) => [name, index]));
  const line = (name) => ({ color: colourOf(places.get(name)), dash: dashOf(places.get(name)), width: 2 });
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  const element = (name, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  };
  const drawn = (name, attributes = {}, ...children) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  /** The text of a script element that holds it as gzip in base64. */
  async function unpack(id) {
    const letters = atob(document.getElementById(id).textContent), bytes = new Uint8Array(letters.length);
    for (let place = 0; place < letters.length; place++) bytes[place] = letters.charCodeAt(place);
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }
  const scenes = new Map();
  function sceneAt(index) {
    if (!scenes.has(index)) scenes.set(index, unpack(`scene-${index}`).then(JSON.parse));
    return scenes.get(index);
  }
  const number = (value, digits = 3) => {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    return size === 0 || (size >= 1e-3 && size < 1e5) ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1);
  };

  // ------------------------------------------------------------------------------------------------ tables

  function sortBy(button) {
    const heading = button.closest("th"), table = heading.closest("table"), body = table.tBodies[0];
    const column = heading.cellIndex;
    const first = button.hasAttribute("data-descending") ? "descending" : "ascending";
    const other = first === "ascending" ? "descending" : "ascending";
    const order = heading.getAttribute("aria-sort") === first ? other : first;
    for (const each of heading.parentElement.cells) each.setAttribute("aria-sort", each === heading ? order : "none");
    const sign = order === "ascending" ? 1 : -1;
    const key = (row) => {
      const cell = row.cells[column];
      if (cell.tagName === "TH") return cell.textContent;
      return cell.dataset.value === undefined ? null : Number(cell.dataset.value);
    };
    const numeric = (row) => typeof key(row) === "number";
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (x === null || y === null) return (x === null) - (y === null);  // cells without a value come last
      return sign * (numeric(a) ? x - y : x.localeCompare(y));
    };
    body.append(...[...body.rows].sort(compare));
    document.getElementById("status").textContent = `${table.caption.textContent}: sorted by ${button.textContent}, ${order}`;
  }
  for (const button of document.querySelectorAll("table.sortable thead button")) button.addEventListener("click", () => sortBy(button));

  // ------------------------------------------------------------------------------------------- choosing policies

  function choices(fieldset, names, chosen, changed, swatches = true) {
    for (const label of fieldset.querySelectorAll("label")) label.remove();
    const boxes = names.map((name) => {
      const box = element("input", { type: "checkbox", value: name, checked: chosen.includes(name) });
      const swatch = element("span", { className: "swatch", hidden: !swatches });
      swatch.style.borderTopColor = line(name).color;
      swatch.style.borderTopStyle = { solid: "solid", dash: "dashed", dot: "dotted" }[line(name).dash];
      box.addEventListener("change", () => changed(boxes.filter((each) => each.checked).map((each) => each.value)));
      fieldset.append(element("label", {}, box, swatch, name));
      return box;
    });
  }

  // ------------------------------------------------------------------------------------------------- figures

  const axis = (title, more = {}) => ({
    title: { text: title, standoff: 8 }, gridcolor: colour("--grid"), zerolinecolor: colour("--grid"), linecolor: colour("--line"), automargin: true, ...more,
  });
  const layout = (more) => ({
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: colour("--ink"), family: "inherit", size: 13 },
    margin: { l: 55, r: 12, t: 12, b: 45 }, showlegend: false, hovermode: "closest", ...more,
  });
  const settings = { responsive: true, displayModeBar: false };
  const redraws = new Map();  // chart → function that draws it again when the colour scheme changes

  function drawProfiles() {
    const chart = document.getElementById("profiles-chart");
    if (!chart) return;
    const names = Object.keys(figures.profiles);
    let chosen = figures.shown.filter((name) => names.includes(name));
    if (!chosen.length) chosen = names.slice(0, 5);
    const draw = () => Plotly.react(chart, chosen.map((name) => ({
      x: figures.thresholds, y: figures.profiles[name], name, mode: "lines", line: line(name), hovertemplate: "%{fullData.name}<br>τ = %{x}: %{y:.3f}<extra></extra>",
    })), layout({ height: 380, xaxis: axis("normalised score τ"), yaxis: axis("share of episodes above τ", { range: [0, 1.02] }) }), settings);
    choices(document.getElementById("profiles-choice"), names, chosen, (names_) => { chosen = names_; draw(); });
    redraws.set(chart, draw);
    draw();
  }

  async function drawErrors(section) {
    const chart = section.querySelector(".chart");
    if (redraws.has(chart)) return;
    redraws.set(chart, () => {});  // until it is drawn
    const scene = await sceneAt(Number(section.dataset.scene));
    let chosen = scene.shown;
    const traces = (name, index) => {
      const [low, middle, high] = scene.traces[name].errors.map((row) => row.map((value) => 10 ** value));
      return ["t", "s"].flatMap((clock, panel) => {
        const end = clock === "s" ? scene.deadline + 1 : scene.t.length;
        const x = scene[clock].slice(0, end);
        const on = panel ? { xaxis: "x2", yaxis: "y2" } : {};
        const band = { x: [...x, ...[...x].reverse()], y: [...low.slice(0, end), ...high.slice(0, end).reverse()], fill: "toself", fillcolor: `${line(name).color}2e`, line: { width: 0 }, mode: "lines", hoverinfo: "skip" };
        const median = { x, y: middle.slice(0, end), name, mode: "lines", line: line(name), hovertemplate: `%{fullData.name}<br>${clock} = %{x:.4g}: %{y:.2e}<extra></extra>` };
        return scene.episodes > 1 ? [{ ...band, ...on }, { ...median, ...on }] : [{ ...median, ...on }];
      });
    };
    const draw = () => {
      const narrow = chart.clientWidth < 640;
      const scale = { type: "log", exponentformat: "power", dtick: 2 };
      const deadline = { type: "line", xref: "x", yref: "y domain", x0: scene.t[scene.deadline], x1: scene.t[scene.deadline], y0: 0, y1: 1, line: { color: colour("--faint"), width: 1, dash: "dot" } };
      return Plotly.react(chart, chosen.flatMap(traces), layout({
        height: narrow ? 620 : 380, grid: { rows: narrow ? 2 : 1, columns: narrow ? 1 : 2, pattern: "independent", xgap: 0.12, ygap: 0.25 },
        xaxis: axis("time t [s]"), yaxis: axis("relative error of estimates", scale), xaxis2: axis("transformed time s"), yaxis2: axis("", { ...scale, matches: "y" }),
        shapes: [deadline],
      }), settings);
    };
    choices(section.querySelector(".choice"), Object.keys(scene.traces), chosen, (names) => { chosen = names; draw(); });
    redraws.set(chart, draw);
    draw();
  }

  function drawFigures() {
    drawProfiles();
    for (const section of document.querySelectorAll("details.section")) {
      if (section.open) drawErrors(section);
      section.addEventListener("toggle", () => { if (section.open) drawErrors(section); });
    }
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const draw of redraws.values()) draw(); });

  // -------------------------------------------------------------------------------------------------- player

  const decoded = new Map();
  function floats(text) {
    if (!decoded.has(text)) {
      const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
      decoded.set(text, new Float32Array(bytes.buffer));
    }
    return decoded.get(text);
  }
  const rows = (text, frames) => {
    const values = floats(text);
    return Array.from({ length: values.length / frames }, (_, row) => values.subarray(row * frames, (row + 1) * frames));
  };
  const WIDTH = 400, LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 20;

  /** A small chart of lines over time with a cursor and a mark at the deadline, an index. y is drawn as scale(y); values beyond the range are cut. */
  function lineChart([axisName, x], deadline, series, { height, low, high, ticks, marks = [], scale = (value) => value, written = number, label }) {
    const [from, to] = [x[0], x[x.length - 1]];
    const px = (value) => LEFT + (value - from) / (to - from || 1) * (WIDTH - LEFT - RIGHT);
    const py = (value) => height - BOTTOM - (scale(Math.min(high, Math.max(low, value))) - scale(low)) / (scale(high) - scale(low) || 1) * (height - TOP - BOTTOM);
    const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": label });
    for (const tick of ticks) {
      svg.append(drawn("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: py(tick), y2: py(tick) }));
      svg.append(drawn("text", { x: LEFT - 5, y: py(tick) + 4, "text-anchor": "end" }, written(tick)));
    }
    for (const [value, anchor] of [[from, "start"], [to, "end"]]) svg.append(drawn("text", { x: px(value), y: height - 5, "text-anchor": anchor }, number(value)));
    svg.append(drawn("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: height - 5, "text-anchor": "middle" }, axisName === "t" ? "t [s]" : "s"));
    for (const [value, stroke] of marks) svg.append(drawn("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: py(value), y2: py(value), stroke, "stroke-dasharray": "1 3" }));
    if (x[deadline] < to) svg.append(drawn("line", { class: "deadline", x1: px(x[deadline]), x2: px(x[deadline]), y1: TOP, y2: height - BOTTOM }), drawn("text", { x: px(x[deadline]) - 3, y: TOP + 11, "text-anchor": "end" }, "T"));
    for (const { y, stroke, width = 1.8, opacity = 1 } of series) {
      let path = "", pen = "M";
      y.forEach((value, index) => {
        if (Number.isFinite(value)) { path += `${pen}${px(x[index]).toFixed(1)} ${py(value).toFixed(1)}`; pen = "L"; } else pen = "M";
      });
      svg.append(drawn("path", { d: path, fill: "none", stroke, "stroke-width": width, opacity }));
    }
    svg.append(drawn("rect", { class: "frame", x: LEFT, y: TOP, width: WIDTH - LEFT - RIGHT, height: height - TOP - BOTTOM }));
    const cursor = drawn("line", { class: "cursor", y1: TOP, y2: height - BOTTOM });
    const dots = series.filter((one) => one.dot).map((one) => ({ one, dot: drawn("circle", { r: 3.5, fill: one.stroke }) }));
    svg.append(cursor, ...dots.map(({ dot }) => dot));
    const move = (frame) => {
      for (const end of ["x1", "x2"]) cursor.setAttribute(end, px(x[frame]));
      for (const { one, dot } of dots) {
        dot.setAttribute("visibility", Number.isFinite(one.y[frame]) ? "visible" : "hidden");
        if (Number.isFinite(one.y[frame])) { dot.setAttribute("cx", px(x[frame])); dot.setAttribute("cy", py(one.y[frame])); }
      }
    };
    return { svg, move };
  }

  const niceTicks = (low, high, count = 4) => {
    const rough = (high - low) / count || 1, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= rough);
    const ticks = [];
    for (let tick = Math.ceil(low / step) * step; tick <= high + 1e-9 * step; tick += step) ticks.push(Number(tick.toPrecision(6)));
    return ticks;
  };
  const extent = (series) => series.reduce(([low, high], values) => values.reduce(([a, b], value) => Number.isFinite(value) ? [Math.min(a, value), Math.max(b, value)] : [a, b], [low, high]), [Infinity, -Infinity]);

  function graph(scene, label) {
    const size = 180, radius = 70, svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${size}`, role: "img", "aria-label": label });
    const place = (player) => [WIDTH / 2 + radius * Math.sin(2 * Math.PI * player / scene.players), size / 2 - radius * Math.cos(2 * Math.PI * player / scene.players)];
    const lines = scene.links.map(([i, j]) => {
      const [[x1, y1], [x2, y2]] = [place(i), place(j)];
      return svg.appendChild(drawn("line", { x1, y1, x2, y2 }));
    });
    const crowded = scene.players > 20;
    svg.classList.toggle("crowded", crowded);
    for (let player = 0; player < scene.players; player++) {
      const [cx, cy] = place(player);
      svg.append(drawn("circle", { class: "node", cx, cy, r: crowded ? 3 : scene.players > 10 ? 8 : 10, stroke: colourOf(player) }));
      if (!crowded) svg.append(drawn("text", { class: "name", x: cx, y: cy + 4, "text-anchor": "middle" }, String(player)));
    }
    const move = (frame) => {
      const up = new Set(liveLinks(scene, frame));
      lines.forEach((each, index) => each.setAttribute("class", up.has(index) ? "up" : "down"));
    };
    return { svg, move };
  }
  const liveLinks = (scene, frame) => scene.live.filter(([start]) => start <= frame).at(-1)[1];

  const figure = (caption, content) => element("figure", {}, content, element("figcaption", { textContent: caption }));

  /** A chart of strategies and estimates, or of their distances from the equilibrium in powers of ten. */
  function positions(scene, name, x, view) {
    const trace = scene.traces[name], frames = scene.t.length, far = view === "distance", nash = scene.equilibrium;
    const shown = (row, component) => row.map((offset) => far ? Math.max(-12, Math.log10(Math.abs(offset))) : nash[component] + offset);
    const own = rows(trace.strategies, frames).map((row, component) => ({ y: shown(row, component), stroke: colourOf(scene.owners[component]), dot: true }));
    const others = trace.estimates === null ? [] : rows(trace.estimates, frames).flatMap((row, index) => {
      const component = Math.floor(index / scene.players), owner = scene.owners[component];
      return index % scene.players === owner ? [] : [{ y: shown(row, component), stroke: colourOf(owner), width: 0.8, opacity: 0.45 }];
    });
    const series = [...others, ...own], label = `${far ? "Distances from the Nash equilibrium of strategies and estimates" : "Strategies and estimates against the Nash equilibrium"}, ${name}`;
    let [low, high] = extent(series.map(({ y }) => y));
    if (far) return lineChart(x, scene.deadline, series, { height: 220, low, high, ticks: niceTicks(low, high), written: (power) => `1e${power}`, label });
    const [least, most] = extent([nash, ...series.map(({ y }) => [y[0]])]), room = 2 * (most - least) || 1;  // lines that run away are cut
    [low, high] = [Math.max(low, least - room), Math.min(high, most + room)];
    const margin = 0.04 * (high - low || 1);
    return lineChart(x, scene.deadline, series, {
      height: 220, low: low - margin, high: high + margin, ticks: niceTicks(low, high), marks: nash.map((value, component) => [value, colourOf(scene.owners[component])]), label,
    });
  }

  function card(scene, name, axisName, view) {
    const frames = scene.t.length, trace = scene.traces[name], x = [axisName, scene[axisName]];
    const offsets = rows(trace.strategies, frames), inputs = rows(trace.inputs, frames), gains = rows(trace.gains, frames);
    const position = positions(scene, name, x, view);
    const largest = Math.max(1, ...extent(inputs).map(Math.abs).filter(Number.isFinite));
    const input = lineChart(x, scene.deadline, inputs.map((y, component) => ({ y, stroke: colourOf(scene.owners[component]), width: 1.3, dot: true })), {
      height: 130, low: -largest, high: largest, scale: Math.asinh, ticks: [-1000, -100, -10, -1, 0, 1, 10, 100, 1000].filter((tick) => Math.abs(tick) <= largest && (largest < 20 || tick === 0 || Math.abs(tick) >= 10)),
      label: `Inputs of ${name}`,
    });
    const sorted = gains.flatMap((row) => [...row]).filter(Number.isFinite).sort((a, b) => a - b);
    const quantile = (share) => sorted.length ? sorted[Math.floor(share * (sorted.length - 1))] : 0;
    const gainLow = Math.min(0, quantile(0.03)), gainHigh = Math.max(1, 1.15 * quantile(0.97));
    const gain = lineChart(x, scene.deadline, gains.map((y, player) => ({ y, stroke: colourOf(player), width: 1.3, dot: true })), {
      height: 110, low: gainLow, high: gainHigh, ticks: niceTicks(gainLow, gainHigh, 3), label: `Consensus gains of ${name}`,
    });
    const net = graph(scene, "Communication graph");
    const netCaption = element("figcaption");
    const readout = element("output", { className: "digits" });
    const body = element("tbody");
    const rowsOfTable = offsets.map((_, component) => {
      const row = body.insertRow();
      const owner = scene.owners[component], place = component - scene.owners.indexOf(owner);
      const alone = scene.owners.lastIndexOf(owner) === scene.owners.indexOf(owner);
      row.append(element("th", { scope: "row", textContent: alone ? String(owner) : `${owner} (${place})` }));
      return [0, 1, 2, 3].map(() => row.insertCell());
    });
    const head = element("tr", {}, ...["player", "strategy", "equilibrium", "input", "gain"].map((text) => element("th", { scope: "col", textContent: text })));
    const table = element("table", {}, element("caption", { textContent: `${name} at this instant` }), element("thead", {}, head), body);
    const numbers = element("details", {}, element("summary", { textContent: "Numbers at this instant" }), element("div", { className: "scroll", tabIndex: 0, role: "region", ariaLabel: `Numbers of ${name}` }, table));
    let last = 0;
    const tell = () => rowsOfTable.forEach((cells, component) => [
      scene.equilibrium[component] + offsets[component][last], scene.equilibrium[component], inputs[component][last], gains[scene.owners[component]][last],
    ].forEach((value, index) => { cells[index].textContent = number(value, 4); }));
    numbers.addEventListener("toggle", tell);
    const move = (frame) => {
      last = frame;
      for (const part of [position, input, gain, net]) part.move(frame);
      readout.textContent = trace.error[frame] <= -12 ? "error below 1e-12" : `error ${number(10 ** trace.error[frame], 2)}`;
      const up = liveLinks(scene, frame).map((index) => scene.links[index].join("–"));
      netCaption.textContent = `Live links: ${up.length > 12 ? `${up.length} of ${scene.links.length}` : up.join(", ") || "none"}`;
      if (numbers.open) tell();
    };
    const parts = element("article", { className: "card", ariaLabel: name }, element("header", {}, element("h3", { textContent: name }), readout),
      figure(view === "distance" ? "Distances of strategies and estimates from the equilibrium" : "Strategies and estimates", position.svg), element("figure", {}, net.svg, netCaption), figure("Inputs of the strategies (asinh scale)", input.svg), figure("Consensus gain on the received estimates, per player", gain.svg), numbers);
    return { parts, move };
  }

  function startPlayer() {
    const [select, axisSelect, viewSelect, slider, play, instant, holder] = ["scene", "axis", "view", "frame", "play", "instant", "cards"].map((id) => document.getElementById(`player-${id}`));
    let cards = [], chosen = [], timer = null;
    let scene;
    const move = () => {
      const frame = Number(slider.value);
      const text = `t = ${scene.t[frame].toFixed(3)} s, s = ${scene.s[frame].toFixed(2)}, g(t) = ${number(scene.gain[frame])}/s`;
      instant.textContent = text;
      slider.setAttribute("aria-valuetext", text);
      for (const each of cards) each.move(frame);
    };
    const show = () => {
      cards = chosen.map((name) => card(scene, name, axisSelect.value, viewSelect.value));
      holder.replaceChildren(...cards.map((each) => each.parts));
      move();
    };
    const pause = () => { clearInterval(timer); timer = null; play.textContent = "Play"; };
    const load = async () => {
      pause();
      const asked = Number(select.value), found = await sceneAt(asked);
      if (asked !== Number(select.value)) return;  // another choice was made meanwhile
      scene = found;
      decoded.clear();
      const names = Object.keys(scene.traces), kept = chosen.filter((name) => names.includes(name));
      chosen = kept.length ? kept : [...new Set([scene.shown[0], ...scene.shown.slice(-1)])];
      choices(document.getElementById("player-choice"), names, chosen, (picked) => { chosen = picked; show(); }, false);
      slider.max = scene.t.length - 1;
      slider.value = Math.min(Number(slider.value), scene.t.length - 1);
      show();
    };
    play.addEventListener("click", () => {
      if (timer !== null) { pause(); return; }
      if (slider.value === slider.max) slider.value = 0;
      play.textContent = "Pause";
      timer = setInterval(() => { if (slider.value === slider.max) pause(); else { slider.stepUp(); move(); } }, 100);
    });
    slider.addEventListener("input", () => { pause(); move(); });
    select.addEventListener("change", load);
    for (const each of [axisSelect, viewSelect]) each.addEventListener("change", show);
    return load();
  }
  // Plotly takes most of the time to load: tables and player do not wait for it.
  async function startFigures() {
    document.head.append(element("script", { textContent: await unpack("plotly") }));
    drawFigures();
  }
  startPlayer().then(() => { if (document.querySelector(".chart")) setTimeout(startFigures); });
})();
