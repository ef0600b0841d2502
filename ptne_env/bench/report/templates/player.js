// The episode player: a card per policy with strategies, live links, inputs and gains at the instant of the slider.

const WIDTH = 400, LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 20;

const decoded = new Map();  // rows of codes → their numbers
function rows(coded) {
  if (!decoded.has(coded)) decoded.set(coded, coded.map((row) => Float64Array.from(codesOf(row), valueOf)));
  return decoded.get(coded);
}

const niceTicks = (low, high, count = 4) => {
  const rough = (high - low) / count || 1, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= rough);
  const ticks = [];
  for (let tick = Math.ceil(low / step) * step; tick <= high + 1e-9 * step; tick += step) {
    ticks.push(Number(tick.toPrecision(6)));
  }
  return ticks;
};

/** The smallest and the largest finite value of several series. */
const extent = (series) => {
  let [low, high] = [Infinity, -Infinity];
  for (const values of series) {
    for (const value of values) {
      if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
  }
  return [low, high];
};

/** An SVG path through points; values that are not finite interrupt it. */
function pathOf(xs, ys) {
  let path = "", pen = "M";
  ys.forEach((y, index) => {
    if (Number.isFinite(y)) path += `${pen}${xs[index].toFixed(1)} ${y.toFixed(1)}`;
    pen = Number.isFinite(y) ? "L" : "M";
  });
  return path;
}

/**
 * A small chart of lines over time with a cursor.
 *
 * The deadline is the index of an instant; s ends there, and so do lines over s. y is drawn as scale(y); values beyond
 * low and high are cut. marks are horizontal lines: [value, colour].
 */
function lineChart([axisName, x], deadline, series, options) {
  const { height, low, high, ticks, label, marks = [], scale = (value) => value, written = number } = options;
  const right = WIDTH - RIGHT, bottom = height - BOTTOM, from = x[0], to = x[x.length - 1];
  const px = (value) => LEFT + (value - from) / (to - from || 1) * (right - LEFT);
  const share = (value) => (scale(value) - scale(low)) / (scale(high) - scale(low) || 1);
  const py = (value) => bottom - share(Math.min(high, Math.max(low, value))) * (bottom - TOP);
  const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": label });
  const write = (text, left, base, anchor) => {
    svg.append(drawn("text", { x: left, y: base, "text-anchor": anchor }, text));
  };
  for (const tick of ticks) {
    svg.append(drawn("line", { class: "grid", x1: LEFT, x2: right, y1: py(tick), y2: py(tick) }));
    write(written(tick).replace("-", "−"), LEFT - 5, py(tick) + 4, "end");
  }
  write(number(from), px(from), height - 5, "start");
  write(number(to), px(to), height - 5, "end");
  write(axisName === "t" ? "t [s]" : "s", (LEFT + right) / 2, height - 5, "middle");
  for (const [value, stroke] of marks) {
    svg.append(drawn("line", { x1: LEFT, x2: right, y1: py(value), y2: py(value), stroke, "stroke-dasharray": "1 3" }));
  }
  if (x[deadline] < to) {
    svg.append(drawn("line", { class: "deadline", x1: px(x[deadline]), x2: px(x[deadline]), y1: TOP, y2: bottom }));
    write("T", px(x[deadline]) - 3, TOP + 11, "end");
  }
  const xs = x.map(px), end = axisName === "s" ? deadline + 1 : xs.length;
  for (const { y, stroke, width = 1.8, opacity = 1 } of series) {
    const d = pathOf(xs, Array.from(y.subarray(0, end), (value) => Number.isFinite(value) ? py(value) : NaN));
    svg.append(drawn("path", { d, fill: "none", stroke, "stroke-width": width, opacity }));
  }
  svg.append(drawn("rect", { class: "frame", x: LEFT, y: TOP, width: right - LEFT, height: bottom - TOP }));
  const cursor = drawn("line", { class: "cursor", y1: TOP, y2: bottom });
  const marked = series.filter((one) => one.dot);
  const dots = marked.map((one) => ({ one, dot: drawn("circle", { r: 3.5, fill: one.stroke }) }));
  svg.append(cursor, ...dots.map(({ dot }) => dot));
  const move = (frame) => {
    for (const end of ["x1", "x2"]) cursor.setAttribute(end, xs[frame]);
    for (const { one, dot } of dots) {
      const visible = Number.isFinite(one.y[frame]);
      dot.setAttribute("visibility", visible ? "visible" : "hidden");
      if (!visible) continue;
      dot.setAttribute("cx", xs[frame]);
      dot.setAttribute("cy", py(one.y[frame]));
    }
  };
  return { svg, move };
}

const liveLinks = (scene, frame) => scene.live.filter(([start]) => start <= frame).at(-1)[1];

/** The places of the players on a circle, clockwise from the top. */
function circle(scene) {
  const height = 180, radius = 70;
  const place = (player) => {
    const angle = 2 * Math.PI * player / scene.players;
    return [WIDTH / 2 + radius * Math.sin(angle), height / 2 - radius * Math.cos(angle)];
  };
  return { height, place, marks: [], label: "Communication graph" };
}

/** The places of players whose strategies are positions in the plane, with their paths and the equilibrium. */
function plane(scene, name) {
  const height = 300, margin = 18, strategies = rows(scene.traces[name].strategies), nash = scene.equilibrium;
  const at = (component, frame) => nash[component] + strategies[component][frame];
  const players = Array.from({ length: scene.players }, (_, player) => scene.owners.indexOf(player));
  const ranges = [0, 1].map((axis) => extent([players.flatMap((first) => [at(first + axis, 0), nash[first + axis]])]));
  const scale = Math.min(...ranges.map(([low, high], axis) => ([WIDTH, height][axis] - 2 * margin) / (high - low || 1)));
  const [[x, y]] = [ranges.map(([low, high]) => (low + high) / 2)];
  const point = (left, up) => [WIDTH / 2 + scale * (left - x), height / 2 - scale * (up - y)];
  const place = (player, frame) => point(at(players[player], frame), at(players[player] + 1, frame));
  const marks = players.flatMap((first, player) => {
    const track = scene.t.map((_, frame) => place(player, frame)), [cx, cy] = point(nash[first], nash[first + 1]);
    const d = pathOf(track.map(([left]) => left), track.map(([, base]) => base));
    const cross = `M${cx - 4} ${cy - 4}l8 8m0 -8l-8 8`, stroke = colourOf(player);
    return [
      drawn("path", { d, fill: "none", stroke, "stroke-width": 1.2, opacity: 0.6 }),
      drawn("path", { d: cross, fill: "none", stroke, "stroke-width": 2 }),
    ];
  });
  return { height, place, marks, label: `Map of the players, ${name}` };
}

/** The players with the numbers of their agents, and the links between them. */
function network(scene, { height, place, marks, label }) {
  const crowded = scene.players > 20;
  const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": label });
  svg.classList.toggle("crowded", crowded);
  const lines = scene.links.map(() => svg.appendChild(drawn("line")));
  svg.append(...marks);
  const r = crowded ? 3 : scene.players > 10 ? 8 : 10;
  const nodes = Array.from({ length: scene.players }, (_, player) => {
    const node = svg.appendChild(drawn("circle", { class: "node", r, stroke: colourOf(player) }));
    if (crowded) return [node];
    return [node, svg.appendChild(drawn("text", { class: "name", "text-anchor": "middle" }, String(player)))];
  });
  const set = (part, attributes) => {
    for (const [key, value] of Object.entries(attributes)) part.setAttribute(key, value);
  };
  const move = (frame) => {
    const up = new Set(liveLinks(scene, frame)), places = nodes.map((_, player) => place(player, frame));
    lines.forEach((each, index) => {
      const [[x1, y1], [x2, y2]] = scene.links[index].map((player) => places[player]);
      set(each, { x1, y1, x2, y2, class: up.has(index) ? "up" : "down" });
    });
    nodes.forEach(([node, text], player) => {
      const [cx, cy] = places[player];
      set(node, { cx, cy });
      if (text) set(text, { x: cx, y: cy + 4 });
    });
  };
  return { svg, move };
}

const powerOfTen = (power) => `10${[...String(power)].map((sign) => sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[sign]).join("")}`;

/** A chart of strategies and estimates, or of their distances from the equilibrium in powers of ten. */
function positions(scene, name, x, view) {
  const trace = scene.traces[name], nash = scene.equilibrium;
  const isDistance = view === "distance";
  const shown = (row, component) => row.map(
    (offset) => isDistance ? Math.max(-12, Math.log10(Math.abs(offset))) : nash[component] + offset,
  );
  const stroke = (component) => colourOf(scene.owners[component]);
  const own = rows(trace.strategies).map((row, component) => (
    { y: shown(row, component), stroke: stroke(component), dot: true }
  ));
  const others = trace.estimates === null ? [] : rows(trace.estimates).flatMap((row, index) => {
    const component = Math.floor(index / scene.players);
    const isOwn = index % scene.players === scene.owners[component];
    return isOwn ? [] : [{ y: shown(row, component), stroke: stroke(component), width: 0.8, opacity: 0.45 }];
  });
  const series = [...others, ...own], [low, high] = extent(series.map(({ y }) => y));
  if (isDistance) {
    const label = `Distances from the Nash equilibrium of strategies and estimates, ${name}`;
    const options = { height: 220, low, high, ticks: niceTicks(low, high), written: powerOfTen, label };
    return lineChart(x, scene.deadline, series, options);
  }
  const [least, most] = extent([nash, ...series.map(({ y }) => [y[0]])]), room = 2 * (most - least) || 1;
  const [bottom, top] = [Math.max(low, least - room), Math.min(high, most + room)];  // lines that run away are cut
  const margin = 0.04 * (top - bottom || 1);
  return lineChart(x, scene.deadline, series, {
    height: 220,
    low: bottom - margin,
    high: top + margin,
    ticks: niceTicks(bottom, top),
    marks: nash.map((value, component) => [value, stroke(component)]),
    label: `Strategies and estimates against the Nash equilibrium, ${name}`,
  });
}

const thin = (y, stroke) => ({ y, stroke, width: 1.3, dot: true });

function inputChart(scene, name, x) {
  const inputs = rows(scene.traces[name].inputs);
  const largest = Math.max(1, ...extent(inputs).map(Math.abs).filter(Number.isFinite));
  const ticks = [-1000, -100, -10, -1, 0, 1, 10, 100, 1000].filter(
    (tick) => Math.abs(tick) <= largest && (largest < 20 || tick === 0 || Math.abs(tick) >= 10),
  );
  return lineChart(x, scene.deadline, inputs.map((y, component) => thin(y, colourOf(scene.owners[component]))), {
    height: 130, low: -largest, high: largest, scale: Math.asinh, ticks, label: `Inputs of ${name}`,
  });
}

function gainChart(scene, name, x) {
  const gains = rows(scene.traces[name].gains);
  const sorted = gains.flatMap((row) => [...row]).filter(Number.isFinite).sort((a, b) => a - b);
  const quantile = (share) => sorted.length ? sorted[Math.floor(share * (sorted.length - 1))] : 0;
  const low = Math.min(0, quantile(0.03)), high = Math.max(1, 1.15 * quantile(0.97));
  return lineChart(x, scene.deadline, gains.map((y, player) => thin(y, colourOf(player))), {
    height: 110, low, high, ticks: niceTicks(low, high, 3), label: `Consensus gains of ${name}`,
  });
}

/** The numbers of an instant, in a table that is written while it is open. */
function numbersAt(scene, name) {
  const trace = scene.traces[name], { owners, equilibrium } = scene;
  const [offsets, inputs, gains] = [trace.strategies, trace.inputs, trace.gains].map(rows);
  const body = element("tbody");
  const cells = offsets.map((_, component) => {
    const owner = owners[component], first = owners.indexOf(owner), alone = owners.lastIndexOf(owner) === first;
    const row = body.insertRow();
    const textContent = alone ? String(owner) : `${owner}[${component - first}]`;
    row.append(element("th", { scope: "row", textContent }));
    return [0, 1, 2, 3].map(() => row.insertCell());
  });
  const headings = ["player", "strategy", "equilibrium", "input", "gain"];
  const head = element("tr", {}, ...headings.map((textContent) => element("th", { scope: "col", textContent })));
  const caption = element("caption", { textContent: `${name} at this instant` });
  const table = element("table", {}, caption, element("thead", {}, head), body);
  const region = { className: "scroll", tabIndex: 0, role: "region", ariaLabel: `Numbers of ${name}` };
  const summary = element("summary", { textContent: "Numbers at this instant" });
  const details = element("details", {}, summary, element("div", region, table));
  let last = 0;
  const write = () => cells.forEach((row, component) => {
    const strategy = equilibrium[component] + offsets[component][last];
    const values = [strategy, equilibrium[component], inputs[component][last], gains[owners[component]][last]];
    values.forEach((value, index) => { row[index].textContent = number(value); });
  });
  details.addEventListener("toggle", write);
  const move = (frame) => {
    last = frame;
    if (details.open) write();
  };
  return { details, move };
}

const MAP = "Map of the players: lines are their paths, crosses their places at the equilibrium. ";
const captions = {
  values: "Strategies and estimates",
  distance: "Distances of strategies and estimates from the equilibrium",
};

function card(scene, name, axisName, view) {
  const trace = scene.traces[name], x = [axisName, scene[axisName]];
  const position = positions(scene, name, x, view), numbers = numbersAt(scene, name);
  const net = network(scene, scene.in_plane ? plane(scene, name) : circle(scene));
  const input = inputChart(scene, name, x), gain = gainChart(scene, name, x), errors = errorsOf(trace.error[0]);
  const readout = element("output"), links = element("figcaption");
  const figure = (caption, svg) => element("figure", {}, svg, element("figcaption", { textContent: caption }));
  const move = (frame) => {
    for (const part of [position, input, gain, net, numbers]) part.move(frame);
    const error = errors[frame];
    readout.textContent = error <= -12 ? "error below 1e-12" : `error ${number(10 ** error, 2)}`;
    const up = liveLinks(scene, frame).map((index) => scene.links[index].join("–"));
    const listed = up.length > 12 ? `${up.length} of ${scene.links.length}` : up.join(", ") || "none";
    links.textContent = `${scene.in_plane ? MAP : ""}Live links: ${listed}`;
  };
  const places = [figure(captions[view], position.svg), element("figure", {}, net.svg, links)];
  const article = element("article", { className: "card", ariaLabel: name },
    element("header", {}, element("h3", { textContent: name }), readout),
    ...(scene.in_plane ? places.reverse() : places),
    figure("Inputs of the strategies (asinh scale)", input.svg),
    figure("Consensus gain on the received estimates, per player", gain.svg),
    numbers.details,
  );
  return { article, move };
}

function startPlayer() {
  const byId = (id) => document.getElementById(`player-${id}`);
  const [select, axisSelect, viewSelect, slider, play, instant, holder, choice, note] =
    ["scene", "axis", "view", "frame", "play", "instant", "cards", "choice", "note"].map(byId);
  let cards = [], chosen = [], isChosen = false, timer = null;
  let scene;
  const move = () => {
    const frame = Number(slider.value);
    const clocks = `t = ${scene.t[frame].toFixed(3)} s, s = ${scene.s[frame].toFixed(2)}`;
    const text = `${clocks}, g(t) = ${number(scene.gain[frame])}/s`;
    instant.textContent = text;
    slider.setAttribute("aria-valuetext", text);
    for (const each of cards) each.move(frame);
  };
  const show = () => {
    cards = chosen.map((name) => card(scene, name, axisSelect.value, viewSelect.value));
    holder.replaceChildren(...cards.map(({ article }) => article));
    if (!cards.length) holder.append(element("p", { className: "note", textContent: NONE_CHOSEN }));
    const held = scene.t.length - 1 - scene.deadline;
    note.hidden = axisSelect.value !== "s" || held === 0;
    note.textContent = `Transformed time s ends at the deadline T. The ${held} steps after T have no place on this axis: `
      + "lines end at T, and dots stay at the right edge. The axis t shows these steps.";
    move();
  };
  const pause = () => {
    clearInterval(timer);
    timer = null;
    play.textContent = "Play";
  };
  const advance = () => {
    if (slider.value === slider.max) return pause();
    slider.stepUp();
    move();
  };
  const load = async () => {
    pause();
    const asked = Number(select.value), found = await sceneAt(asked);
    if (asked !== Number(select.value)) return;  // another choice was made meanwhile
    scene = found;
    decoded.clear();
    const names = Object.keys(scene.traces), kept = chosen.filter((name) => names.includes(name));
    chosen = isChosen && kept.length ? kept : scene.picked;  // the reader's choice is kept from track to track
    choices(choice, names, chosen, (picked) => { chosen = picked; isChosen = true; show(); }, false);
    slider.max = scene.t.length - 1;
    slider.value = Math.min(Number(slider.value), scene.t.length - 1);
    show();
  };
  play.addEventListener("click", () => {
    if (timer !== null) return pause();
    if (slider.value === slider.max) slider.value = 0;
    play.textContent = "Pause";
    timer = setInterval(advance, 40);
  });
  slider.addEventListener("input", () => { pause(); move(); });
  select.addEventListener("change", load);
  for (const each of [axisSelect, viewSelect]) each.addEventListener("change", show);
  return load();
}
