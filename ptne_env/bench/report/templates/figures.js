// Performance profiles, and the error of each track against time, drawn by Plotly.

const colour = (role) => getComputedStyle(document.documentElement).getPropertyValue(`--${role}`).trim();
const axis = (title, more = {}) => ({
  title: { text: title, standoff: 8 },
  gridcolor: colour("grid"),
  zerolinecolor: colour("grid"),
  linecolor: colour("line"),
  automargin: true,
  ...more,
});
const layout = (more) => ({
  paper_bgcolor: "rgba(0,0,0,0)",
  plot_bgcolor: "rgba(0,0,0,0)",
  font: { color: colour("ink"), family: "inherit", size: 13 },
  margin: { l: 55, r: 12, t: 12, b: 45 },
  showlegend: false,
  hovermode: "closest",
  ...more,
});
const settings = { responsive: true, displayModeBar: false };
const redraws = new Map();  // chart → function that draws it again when the colour scheme changes

/** A sentence in the middle of a figure without lines. */
const emptied = (chosen) => chosen.length ? {} : {
  annotations: [{ text: NONE_CHOSEN, showarrow: false, xref: "paper", yref: "paper", x: 0.5, y: 0.5 }],
};

/** Draw a figure, and draw it again when the reader chooses other policies: draw(names of policies). */
function drawChosen(chart, fieldset, names, chosen, draw) {
  let shown = chosen;
  const redraw = () => draw(shown);
  choices(fieldset, names, shown, (picked) => { shown = picked; redraw(); });
  redraws.set(chart, redraw);
  redraw();
}

function drawProfiles() {
  const chart = document.getElementById("profiles-chart");
  if (!chart) return;
  const names = Object.keys(figures.profiles), best = figures.shown.filter((name) => names.includes(name));
  const profile = (name) => ({
    x: figures.thresholds,
    y: figures.profiles[name],
    name,
    mode: "lines",
    line: line(name),
    hovertemplate: "%{fullData.name}<br>τ = %{x}: %{y:.3f}<extra></extra>",
  });
  const draw = (chosen) => Plotly.react(chart, chosen.map(profile), layout({
    height: 380,
    xaxis: axis("normalised score τ"),
    yaxis: axis("share of episodes above τ", { range: [0, 1.02] }),
    ...emptied(chosen),
  }), settings);
  drawChosen(chart, document.getElementById("profiles-choice"), names, best.length ? best : names.slice(0, 5), draw);
}

/** The median error of a policy with its band, against t in the first panel and against s in the second. */
function errorLines(scene, name) {
  const [low, middle, high] = scene.traces[name].errors.map((row) => errorsOf(row).map((power) => 10 ** power));
  return ["t", "s"].flatMap((clock, panel) => {
    const end = clock === "s" ? scene.deadline + 1 : scene.t.length, x = scene[clock].slice(0, end);
    const common = { mode: "lines", ...(panel ? { xaxis: "x2", yaxis: "y2" } : {}) };
    const band = {
      ...common,
      x: [...x, ...[...x].reverse()],
      y: [...low.slice(0, end), ...high.slice(0, end).reverse()],
      fill: "toself",
      fillcolor: `${line(name).color}2e`,
      line: { width: 0 },
      hoverinfo: "skip",
    };
    const median = {
      ...common,
      x,
      y: middle.slice(0, end),
      name,
      line: line(name),
      hovertemplate: `%{fullData.name}<br>${clock} = %{x:.4g}: %{y:.2e}<extra></extra>`,
    };
    return scene.episodes > 1 ? [band, median] : [median];
  });
}

async function drawErrors(section) {
  const chart = section.querySelector(".chart");
  if (redraws.has(chart)) return;
  redraws.set(chart, () => {});  // until it is drawn
  const scene = await sceneAt(Number(section.dataset.scene)), end = scene.t[scene.deadline];
  const scale = { type: "log", exponentformat: "power", dtick: 2 };
  const draw = (chosen) => {
    const [rows, columns, height] = chart.clientWidth < 640 ? [2, 1, 620] : [1, 2, 380];
    Plotly.react(chart, chosen.flatMap((name) => errorLines(scene, name)), layout({
      height,
      grid: { rows, columns, pattern: "independent", xgap: 0.12, ygap: 0.25 },
      xaxis: axis("time t [s]"),
      yaxis: axis("relative error of estimates", scale),
      xaxis2: axis("transformed time s"),
      yaxis2: axis("", { ...scale, matches: "y" }),
      shapes: [{
        type: "line", xref: "x", yref: "y domain", x0: end, x1: end, y0: 0, y1: 1,
        line: { color: colour("faint"), width: 1, dash: "dot" },
      }],
      ...emptied(chosen),
    }), settings);
  };
  drawChosen(chart, section.querySelector(".choice"), Object.keys(scene.traces), scene.shown, draw);
}

async function startFigures() {
  document.head.append(element("script", { textContent: await unpack("plotly") }));
  drawProfiles();
  for (const section of document.querySelectorAll("details.section")) {
    if (section.open) drawErrors(section);
    section.addEventListener("toggle", () => { if (section.open) drawErrors(section); });
  }
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const draw of redraws.values()) draw();
});
