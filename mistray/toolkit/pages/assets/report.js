// Tables of class "sortable": a click, Enter or Space on a header sorts; the field above a table filters its rows.
function key(cell) {
  const raw = cell.dataset.v !== undefined ? cell.dataset.v : cell.textContent.trim();
  const n = Number(raw);
  return raw === "" || Number.isNaN(n) ? raw.toLowerCase() : n;
}
function compare(a, b) {
  if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
  return typeof a === "number" ? -1 : 1;
}
function sortTable(table, column, down) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head) => head.removeAttribute("aria-sort"));
  heads[column].setAttribute("aria-sort", down ? "descending" : "ascending");
  [...body.rows]
    .map((row) => [key(row.cells[column]), row])
    .sort((a, b) => (down ? -1 : 1) * compare(a[0], b[0]))
    .forEach((pair) => body.append(pair[1]));
}
// A row is shown if it has all words of the filter and is not put aside (by a box on the detector)
function filterTable(table) {
  const input = document.querySelector(`input.filter[data-table="${table.id}"]`);
  const words = input ? input.value.toLowerCase().split(/\s+/).filter(Boolean) : [];
  for (const row of table.tBodies[0].rows) {
    // the full list of events is left out: most surfaces occur in every path
    const text = [...row.cells].filter((cell) => !cell.classList.contains("path")).map((cell) => cell.textContent).join(" ").toLowerCase();
    row.hidden = row.dataset.aside === "1" || !words.every((word) => text.includes(word));
  }
}
for (const table of document.querySelectorAll("table.sortable")) {
  table.querySelectorAll("thead th").forEach((th, column) => {
    th.tabIndex = 0;
    const sort = () => sortTable(table, column, th.getAttribute("aria-sort") === "ascending");
    th.addEventListener("click", sort);
    th.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      sort();
    });
  });
}
// A link opens what is folded around the place that it leads to; on paper settings are open
function reveal(name) {
  const target = name && document.getElementById(decodeURIComponent(name));
  for (let place = target; place; place = place.parentElement) if (place.tagName === "DETAILS") place.open = true;
}
for (const link of document.querySelectorAll('a[href^="#"]')) link.addEventListener("click", () => reveal(link.hash.slice(1)));
if (typeof window !== "undefined") {
  reveal(location.hash.slice(1));
  let closed = [];
  window.addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("details.printed:not([open])")];
    for (const details of closed) details.open = true;
  });
  window.addEventListener("afterprint", () => { for (const details of closed) details.open = false; });
}
// On a phone each row of a short table with many columns is a card
const MOST_CARDS = 12, FEWEST_COLUMNS = 5;
for (const table of document.querySelectorAll(".wide > table")) {
  const heads = [...table.tHead.rows[0].cells];
  if (heads.length < FEWEST_COLUMNS || table.tBodies[0].rows.length > MOST_CARDS || table.querySelector("button.pick")) continue;
  table.classList.add("cards");
  for (const row of table.tBodies[0].rows) {
    [...row.cells].forEach((cell, k) => { cell.dataset.head = [...heads[k].childNodes].map((node) => node.textContent.trim()).join(" "); });
  }
}
// What is wider than the page fades at its edge until it is scrolled there, and can be scrolled by keys
for (const place of document.querySelectorAll(".wide, figure")) {
  const look = () => {
    const beyond = place.scrollWidth - place.clientWidth;
    place.classList.toggle("more", beyond > 1 && place.scrollLeft < beyond - 1);
    if (beyond > 1 || place.scrollHeight > place.clientHeight + 1) {
      place.tabIndex = 0;
      place.setAttribute("role", "group");
      place.setAttribute("aria-label", place.localName === "figure" ? "picture that scrolls" : "table that scrolls");
    }
  };
  look();
  place.addEventListener("scroll", look, { passive: true });
  if (typeof ResizeObserver === "undefined") continue;
  const watch = new ResizeObserver(look);
  for (const one of [place, ...place.children]) watch.observe(one);
}
for (const input of document.querySelectorAll("input.filter")) {
  const table = document.getElementById(input.dataset.table);
  input.addEventListener("input", () => filterTable(table));
}
