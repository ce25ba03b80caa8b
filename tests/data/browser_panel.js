
const panel = document.querySelector("div.explorer"), canvas = panel.querySelector("canvas");
const table = document.getElementById(panel.dataset.table), which = panel.querySelector("select.which");
const folded = panel.closest("details"), fields = panel.querySelector("form").elements;
const pick = [...table.querySelectorAll("button.pick")].find((button) => button.dataset.path === "1");
const rows = () => [...table.tBodies[0].rows].filter((row) => !row.hidden);
const ids = () => rows().map((row) => row.querySelector("button.pick").dataset.path);
const inBox = () => rows().map((row) => Number(row.querySelector("td.inbox").dataset.v));
const boxed = () => table.classList.contains("boxed"), told = (part) => panel.querySelector(part).textContent;
const label = () => canvas.getAttribute("aria-label");
const choose = (value) => { which.value = value; which.dispatchEvent(new Event("change")); return pause(); };
const click = (control) => { panel.querySelector(control).click(); return pause(); };
const light = () => {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const pen = copy.getContext("2d", { willReadFrequently: true });
  pen.drawImage(canvas, 0, 0);
  const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
  let sum = 0; for (let k = 0; k < data.length; k += 4) sum += data[k]; return sum; };
const drag = (kind, x, y) => {
  const frame = canvas.getBoundingClientRect(), width = frame.width - 52 - 74, height = frame.height - 8 - 36;
  const wide = Math.min(width, height * 4 / 3);
  canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, button: 0, bubbles: true,
    clientX: frame.left + 52 + x * wide, clientY: frame.top + 8 + (1 - y) * wide * 3 / 4 })); };
const enter = (...values) => {
  ["x0", "x1", "y0", "y1"].forEach((name, k) => { fields[name].value = values[k]; });
  panel.querySelector("form").requestSubmit();
  return pause(); };
canvas.setPointerCapture = () => {};  // there is no pointer behind the events
