// Colours, elements and numbers for tables, figures and the player.

const figures = JSON.parse(document.getElementById("figures").textContent);
const dashes = ["solid", "dash", "dot"];
const colourOf = (index) => figures.colours[index % figures.colours.length];
const dashOf = (index) => dashes[Math.floor(index / figures.colours.length) % dashes.length];
const places = new Map(figures.policies.map((name, index) => [name, index]));
const line = (name) => ({ color: colourOf(places.get(name)), dash: dashOf(places.get(name)), width: 2 });

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
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

const scenes = new Map();
function sceneAt(index) {
  if (!scenes.has(index)) scenes.set(index, unpack(`scene-${index}`).then(JSON.parse));
  return scenes.get(index);
}

const number = (value, digits = 3) => {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value), plain = size === 0 || (size >= 1e-3 && size < 1e5);
  return plain ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1);
};

const NONE_CHOSEN = "No policy is chosen: tick one above.";

/** The numbers of a row of codes, each less the code before it; ptne_env/bench/report/pages.py explains them. */
function codesOf(differences) {
  let code = 0;
  return differences.map((difference) => { code += difference; return code; });
}
const FINEST = 1e-13, STEP = 8e-4, NONE = -1e6;
const valueOf = (code) => code === NONE ? NaN : Math.sign(code) * FINEST * 10 ** (STEP * Math.abs(code));
const errorsOf = (differences) => codesOf(differences).map((code) => code / 100);

/** Fill a fieldset with a box per policy; a change calls changed(names of the checked ones). */
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
