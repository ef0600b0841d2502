// The episode player: a card per policy with strategies, errors, inputs and live links at the instant of the slider.

const WIDTH = 400, LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 20;
const colourOf = (player) => COLOURS[player % COLOURS.length];

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

const number = (value, digits = 3) => {
  if (value === null) return "–";
  const size = Math.abs(value), plain = size === 0 || (size >= 1e-3 && size < 1e5);
  return (plain ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1)).replace(/^-/, "−");
};

/** Some round numbers between two. */
function niceTicks(low, high) {
  const rough = (high - low) / 6 || 1, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= rough);
  const ticks = [];
  for (let tick = Math.ceil(low / step); tick <= high / step; tick += 1) ticks.push(Number((tick * step).toPrecision(6)));
  return ticks;
}

/** A small chart of lines over time with a cursor; y is drawn as scale(y), and lines leave the frame beyond low and high. */
function lineChart(scene, lines, options) {
  const { width = WIDTH, height, low, high, ticks, label, scale = (value) => value, written = number } = options;
  const right = width - RIGHT, bottom = height - BOTTOM, end = scene.t.at(-1), deadline = scene.t[scene.deadline];
  const px = (time) => LEFT + time / end * (right - LEFT);
  const share = (value) => (scale(value) - scale(low)) / (scale(high) - scale(low) || 1);
  const py = (value) => bottom - share(value) * (bottom - TOP);
  const svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  const write = (text, x, y, anchor) => svg.append(drawn("text", { x, y, "text-anchor": anchor }, text));
  for (const tick of ticks) {
    svg.append(drawn("line", { class: "grid", x1: LEFT, x2: right, y1: py(tick), y2: py(tick) }));
    write(written(tick), LEFT - 5, py(tick) + 4, "end");
  }
  write("0", LEFT, height - 5, "start");
  write(`t = ${number(end)} s`, right, height - 5, "end");
  if (deadline < end) {
    svg.append(drawn("line", { class: "deadline", x1: px(deadline), x2: px(deadline), y1: TOP, y2: bottom }));
    write("T", px(deadline) - 3, TOP + 11, "end");
  }
  const inside = `clip-path: inset(${TOP - 1}px ${RIGHT}px ${BOTTOM - 1}px ${LEFT}px) view-box`;
  const curves = svg.appendChild(drawn("g", { style: inside }));
  for (const { from, y, ...style } of lines) {
    let d = "";
    y.forEach((value, frame) => {
      if (value === null) return;
      d += `${d && y[frame - 1] !== null ? "L" : "M"}${px(scene.t[frame]).toFixed(1)} ${py(value).toFixed(1)}`;
    });
    if (from) d += from.map((value, frame) => `L${px(scene.t[frame]).toFixed(1)} ${py(value).toFixed(1)}`).reverse().join("");
    curves.append(drawn("path", { d, fill: "none", ...style }));
  }
  svg.append(drawn("rect", { class: "frame", x: LEFT, y: TOP, width: right - LEFT, height: bottom - TOP }));
  const cursor = svg.appendChild(drawn("line", { class: "cursor", y1: TOP, y2: bottom }));
  const move = (frame) => {
    for (const side of ["x1", "x2"]) cursor.setAttribute(side, px(scene.t[frame]));
  };
  return { svg, move };
}

/** Strategies as thick lines, estimates of other players as thin ones, the equilibrium dotted. */
function strategyChart(scene, name) {
  const { strategies, estimates } = scene.traces[name], { equilibrium, owners } = scene;
  const stroke = (component) => colourOf(owners[component]);
  const lines = [
    ...estimates.flatMap((players, component) => players.map((y) => (
      { y, stroke: stroke(component), "stroke-width": 0.8, opacity: 0.45 }
    ))),
    ...equilibrium.map((value, component) => (
      { y: scene.t.map(() => value), stroke: stroke(component), "stroke-dasharray": "1 3" }
    )),
    ...strategies.map((y, component) => (
      { y, stroke: stroke(component), "stroke-width": 1.8 }
    )),
  ];
  const starts = [...equilibrium, ...lines.map(({ y }) => y[0])], first = Math.min(...starts), last = Math.max(...starts);
  const room = 2 * (last - first) || 1;  // lines that run farther leave the frame
  const near = lines.flatMap(({ y }) => y).filter((value) => value !== null && first - room <= value && value <= last + room);
  const least = near.reduce((one, other) => Math.min(one, other)), most = near.reduce((one, other) => Math.max(one, other));
  const margin = (most - least) / 25 || 1, low = least - margin, high = most + margin;
  const label = `Strategies and estimates of ${name}`;
  return lineChart(scene, lines, { height: 220, low, high, ticks: niceTicks(low, high), label });
}

const superscript = (power) => [...String(power)].map((sign) => sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[sign]).join("");

const logarithms = (values) => values.map((value) => Math.log10(Math.max(value, 1e-12)));

/** A chart of logarithms of errors, over whole powers of ten. */
function powerChart(scene, lines, options) {
  const values = lines.flatMap(({ y, from = [] }) => [...y, ...from]);
  const low = Math.floor(Math.min(...values)), high = Math.max(Math.ceil(Math.max(...values)), low + 1);
  const ticks = niceTicks(low, high).filter(Number.isInteger);
  return lineChart(scene, lines, { low, high, ticks, written: (power) => `10${superscript(power)}`, ...options });
}

function errorChart(scene, name) {
  const lines = [{ y: logarithms(scene.traces[name].error), stroke: "var(--accent)", "stroke-width": 1.8 }];
  return powerChart(scene, lines, { height: 120, label: `Error of the estimates of ${name}` });
}

/** The errors of all policies of a scene over its episodes: medians, and bands where there are several. */
function errorsChart(scene, width) {
  const traces = Object.entries(scene.traces).map(([name, { errors }]) => [POLICIES[name], errors.map(logarithms)]);
  const lines = [
    ...traces.filter(([, errors]) => errors.length > 1).map(([fill, [from, , y]]) => ({ y, from, fill, opacity: 0.2 })),
    ...traces.map(([stroke, errors]) => ({ y: errors.at(errors.length > 1 ? 1 : 0), stroke, "stroke-width": 2 })),
  ].reverse();  // the first policy, the law of the paper, is drawn last: nothing hides it
  return powerChart(scene, lines, { width, height: 300, label: "Errors of the estimates over time" });
}

function legend(names) {
  return element("p", { className: "note" }, ...names.flatMap((name) => {
    const mark = element("span", { textContent: "● " });
    mark.style.color = POLICIES[name];
    return [mark, `${name}\u2003`];
  }));
}

function inputChart(scene, name) {
  const { inputs } = scene.traces[name];
  const largest = Math.max(1, ...inputs.flat().map(Math.abs)), ticks = [-1000, -100, -10, 0, 10, 100, 1000];
  const lines = inputs.map((y, component) => ({ y, stroke: colourOf(scene.owners[component]), "stroke-width": 1.3 }));
  const shown = ticks.filter((tick) => Math.abs(tick) <= largest);
  const options = { height: 130, low: -largest, high: largest, ticks: shown, scale: Math.asinh, label: `Inputs of ${name}` };
  return lineChart(scene, lines, options);
}

/** The players on a circle, clockwise from the top, and the links between them, with arrows where they have one way. */
function network(scene) {
  const isCrowded = scene.players > 20, radius = isCrowded ? 3 : 10;
  const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} 180`, role: "img", "aria-label": "Communication graph" });
  const places = Array.from({ length: scene.players }, (_, player) => {
    const angle = 2 * Math.PI * player / scene.players;
    return [WIDTH / 2 + 70 * Math.sin(angle), 90 - 70 * Math.cos(angle)];
  });
  const marker = drawn("marker", { id: "arrow", refX: 4, refY: 4, markerWidth: 8, markerHeight: 8, orient: "auto" });
  marker.append(drawn("path", { d: "M0,0 L8,4 L0,8 z" }));
  svg.append(marker);
  const lines = scene.links.map(([sender, receiver, isOneWay]) => {
    const [[x1, y1], [x2, y2]] = [places[sender], places[receiver]];
    const points = `${x1},${y1} ${(x1 + x2) / 2},${(y1 + y2) / 2} ${x2},${y2}`;
    return svg.appendChild(drawn("polyline", { points, "marker-mid": isOneWay ? "url(#arrow)" : "none" }));
  });
  places.forEach(([cx, cy], player) => {
    svg.append(drawn("circle", { class: "node", cx, cy, r: radius, stroke: colourOf(player) }));
    if (!isCrowded) svg.append(drawn("text", { x: cx, y: cy + 4, "text-anchor": "middle" }, String(player)));
  });
  const move = (frame) => {
    const up = scene.live.findLast(([start]) => start <= frame)[1];
    lines.forEach((line, index) => line.setAttribute("class", up.includes(index) ? "up" : "down"));
  };
  return { svg, move };
}

function card(scene, name) {
  const readout = element("output");
  const parts = [
    [strategyChart(scene, name), "Strategies (thick), estimates of others (thin), equilibrium (dotted)"],
    [errorChart(scene, name), "Relative error of all estimates"],
    [inputChart(scene, name), "Inputs of the strategies (asinh scale)"],
    [network(scene), "Live links"],
  ];
  const move = (frame) => {
    for (const [part] of parts) part.move(frame);
    readout.textContent = `error ${number(scene.traces[name].error[frame], 2)}`;
  };
  const figures = parts.map(([{ svg }, textContent]) => (
    element("figure", {}, svg, element("figcaption", { textContent }))
  ));
  const header = element("header", {}, element("h3", { textContent: name }), readout);
  return { article: element("article", { className: "card", ariaLabel: name }, header, ...figures), move };
}

function startPlayer() {
  const [select, play, slider, instant, holder] = ["scene", "play", "frame", "instant", "cards"].map(
    (id) => document.getElementById(`player-${id}`),
  );
  if (!select) return;
  let scene = null, cards = [], timer = null;
  const move = () => {
    const frame = Number(slider.value);
    const clocks = `t = ${scene.t[frame].toFixed(3)} s, s = ${scene.s[frame].toFixed(2)}`;
    instant.textContent = `${clocks}, g(t) = ${number(scene.gain[frame])}/s`;
    slider.setAttribute("aria-valuetext", instant.textContent);
    for (const each of cards) each.move(frame);
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
    const asked = select.value, found = JSON.parse(await unpack(`scene-${asked}`));
    if (asked !== select.value) return;  // another choice was made meanwhile
    scene = found;
    cards = Object.keys(scene.traces).map((name) => card(scene, name));
    holder.replaceChildren(...cards.map(({ article }) => article));
    slider.max = scene.t.length - 1;
    move();
  };
  play.addEventListener("click", () => {
    if (timer !== null) return pause();
    if (slider.value === slider.max) slider.value = 0;
    play.textContent = "Pause";
    timer = setInterval(advance, 40);
  });
  slider.addEventListener("input", () => { pause(); move(); });
  select.addEventListener("change", load);
  load();
}

startPlayer();
