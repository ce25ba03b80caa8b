
const pause = () => new Promise((done) => setTimeout(done, 50));
const press = (target, key, more) =>
  target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...more }));
// Controls by their kind, so that one of many alike stands for all of them
const CONTROLS = "button, select, input, summary, th[tabindex], canvas[tabindex], div[tabindex]:not(.wide)";
const kind = (control) => [control.localName, control.type, control.name, control.className].filter(Boolean).join(" ");
const used = new Set();
for (const name of ["click", "keydown", "input", "change", "submit", "reset", "pointerdown"])
  document.addEventListener(name, ({ target }) => {
    const control = target.closest && target.closest(CONTROLS);
    if (control) used.add(kind(control));
    if (name === "submit") target.querySelectorAll("input, [type=submit]").forEach((one) => used.add(kind(one)));
  }, true);
const unused = () => [...new Set([...document.querySelectorAll(CONTROLS)].map(kind))].filter((name) => !used.has(name));
// A head of each kind sorts its column up and down; a word that no row has hides all rows; what is folded opens
function tables() {
  const value = (cell) => (cell.dataset.v === undefined || cell.dataset.v === "" ? NaN : Number(cell.dataset.v));
  const sorted = {}, seen = new Set();
  for (const head of document.querySelectorAll("table th[tabindex]")) {
    const rows = [...head.closest("table").tBodies[0].rows];
    if (seen.has(head.className) || rows.length < 2) continue;
    seen.add(head.className);
    const place = [...head.parentNode.cells].indexOf(head);
    const column = () => [...head.closest("table").tBodies[0].rows].map((row) => value(row.cells[place]));
    const rises = (all, sign) => all.every((v, k) => !k || Number.isNaN(v) || !(sign * v < sign * all[k - 1]));
    press(head, "Enter");
    const up = rises(column(), 1), told = head.getAttribute("aria-sort");
    head.click();
    sorted[head.className] = [up, told, rises(column(), -1), head.getAttribute("aria-sort")];
  }
  const filter = document.querySelector("input.filter"), table = document.getElementById(filter.dataset.table);
  const shown = () => [...table.tBodies[0].rows].filter((row) => !row.hidden).length;
  const type = (words) => { filter.value = words; filter.dispatchEvent(new Event("input")); return shown(); };
  const filtered = [type("no such word"), type(""), table.tBodies[0].rows.length];
  const folded = document.querySelector("details"), before = folded.open;
  folded.querySelector("summary").click();
  const opens = folded.open !== before;
  folded.querySelector("summary").click();
  return { sorted, filtered, opens };
}
function values() {
  const plot = document.querySelector("div.hover"), svg = plot.querySelector("svg"), tip = plot.querySelector(".tip");
  const told = [], tell = () => told.push(tip.hidden || tip.querySelector("caption").textContent);
  tell();
  press(plot, "ArrowRight"); tell();
  press(plot, "ArrowRight"); tell();
  const box = svg.getBoundingClientRect();
  svg.dispatchEvent(new PointerEvent("pointermove", { clientX: box.right, clientY: box.top + 50 })); tell();
  press(plot, "Escape"); tell();
  return told;
}
