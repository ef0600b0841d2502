// Sorting of tables by a click on a heading; honest entries, coded ones and oracles stay apart.

function sortBy(button) {
  const heading = button.closest("th"), table = heading.closest("table");
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
  const compare = (a, b) => {
    const [x, y] = [key(a), key(b)];
    if (x === null || y === null) return (x === null) - (y === null);  // cells without a value come last
    return sign * (typeof x === "number" ? x - y : x.localeCompare(y));
  };
  for (const body of table.tBodies) body.append(...[...body.rows].sort(compare));
  const status = `${table.caption.textContent}: sorted by ${button.textContent}, ${order}`;
  document.getElementById("status").textContent = status;
}

for (const button of document.querySelectorAll("table.sortable thead button")) {
  button.addEventListener("click", () => sortBy(button));
}
