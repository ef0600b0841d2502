// Sorting of tables, and charts that are drawn when they are seen.

/** The text of a script element that holds it as gzip in base64. */
async function unpack(id) {
  const text = document.getElementById(`${id}-data`).textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

function sortBy(heading) {
  const table = heading.closest("table"), body = table.tBodies[0], column = heading.cellIndex;
  const [first, second] = column === 0 ? ["ascending", "descending"] : ["descending", "ascending"];
  const order = heading.ariaSort === first ? second : first;
  for (const each of heading.parentElement.cells) each.removeAttribute("aria-sort");
  heading.ariaSort = order;
  const sign = order === "ascending" ? 1 : -1;
  const value = (row) => Number(row.cells[column].dataset.value ?? Infinity * sign);  // without a value: last
  const text = (row) => row.cells[column].textContent;
  const compare = (a, b) => column === 0 ? text(a).localeCompare(text(b)) : value(a) - value(b) || 0;
  body.append(...[...body.rows].sort((a, b) => sign * compare(a, b)));
}

for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => sortBy(button.closest("th")));
}

async function draw(chart) {
  const scene = JSON.parse(await unpack(chart.dataset.scene));
  chart.replaceChildren(legend(Object.keys(scene.traces)), errorsChart(scene, chart.clientWidth).svg);
}

const watcher = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    watcher.unobserve(target);
    draw(target);
  }
});
for (const chart of document.querySelectorAll(".chart")) watcher.observe(chart);
