// Panels of class "explorer": the map, the rays and the events of a path that is chosen in the table; a box on the map
// shows the paths that light it. The page holds powers in W on cells of whole pixels, see mistray/report/embedded.py.
function readMap(entry, powers) {
  const [pixels, column, row, width, height, place] = entry;
  return { pixels, column, row, width, height, power: powers.subarray(place, place + width * height) };
}
function together(a, b) {  // the sum of two maps, on the larger of their cells
  const pixels = Math.max(a.pixels, b.pixels), lit = [a, b].filter((map) => map.width);
  if (!lit.length) return a;
  const cells = (map) => [map.column, map.column + map.width, map.row, map.row + map.height].map(
    (v, k) => k % 2 ? Math.ceil(v * map.pixels / pixels) : Math.floor(v * map.pixels / pixels));
  const ends = [0, 1, 2, 3].map((k) => Math[k % 2 ? "max" : "min"](...lit.map((map) => cells(map)[k])));
  const [column, row, width, height] = [ends[0], ends[2], ends[1] - ends[0], ends[3] - ends[2]];
  const power = new Float64Array(width * height);
  for (const map of lit) {
    for (let r = 0; r < map.height; r += 1) {
      for (let c = 0; c < map.width; c += 1) {
        const to = [map.row + r, map.column + c].map((v) => Math.floor(v * map.pixels / pixels));
        power[(to[0] - row) * width + to[1] - column] += map.power[r * map.width + c];
      }
    }
  }
  return { pixels, column, row, width, height, power };
}
function powerWithin(map, box) {  // box: first column, the one after the last, first row, the one after the last; pixels
  const low = (value, start) => Math.max(Math.floor(value / map.pixels) - start, 0);
  const c0 = low(box[0], map.column), c1 = Math.min(low(box[1], map.column), map.width);
  const r0 = low(box[2], map.row), r1 = Math.min(low(box[3], map.row), map.height);
  let sum = 0;
  for (let r = r0; r < r1; r += 1) for (let c = c0; c < c1; c += 1) sum += map.power[r * map.width + c];
  return sum;
}
function powerAbout(map, box) {  // the same of a map whose cells the box may cut: a part of a cell has its part of the power
  const part = (value, start, end) => Math.max(Math.min(end, (value + 1) * map.pixels) - Math.max(start, value * map.pixels), 0) / map.pixels;
  let sum = 0;
  for (let r = 0; r < map.height; r += 1) {
    const high = part(map.row + r, box[2], box[3]);
    for (let c = 0; high > 0 && c < map.width; c += 1) sum += map.power[r * map.width + c] * high * part(map.column + c, box[0], box[1]);
  }
  return sum;
}
function snapBox(corners, extent, shape, grid) {  // corners x0, x1, y0, y1 in mm, in any order; at least one cell
  const pixels = [];
  [0, 1].forEach((axis) => {
    const origin = extent[2 * axis], count = shape[1 - axis], size = (extent[2 * axis + 1] - origin) / count;
    const ends = corners.slice(2 * axis, 2 * axis + 2).map((v) => (v - origin) / size / grid).sort((a, b) => a - b);
    const most = Math.ceil(count / grid);
    // Half a hair, so that a box that was snapped before stays as it is
    const first = Math.min(Math.max(Math.floor(ends[0] + 1e-6), 0), most - 1);
    const last = Math.min(Math.max(Math.ceil(ends[1] - 1e-6), first + 1), most);
    pixels.push(first * grid, last * grid);
  });
  const mm = pixels.map((v, k) => {
    const axis = k >> 1, count = shape[1 - axis];
    return extent[2 * axis] + (extent[2 * axis + 1] - extent[2 * axis]) * Math.min(v, count) / count;
  });
  return { pixels, mm };
}
function numberOf(text) {  // with a decimal point or a decimal comma; NaN of anything else
  const plain = text.trim().replace("−", "-").replace(",", ".");
  return plain === "" ? Number.NaN : Number(plain);
}
async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const DECADES = { light: 12, stray: 12, path: 6 };
const SMALL_SHARE = 0.4;  // of the detector, below which the map zooms to a path that is chosen
const FEWEST_CELLS = 24;  // along a side of the map, so that a path of one cell has surroundings
const OTHER_PATH = "#8a6d1d";  // of a path that the layout does not show

class Explorer {
  constructor(panel, shared) {
    this.panel = panel;
    this.shared = shared;
    this.table = document.getElementById(panel.dataset.table);
    this.order = [...this.table.tBodies[0].rows];
    this.canvas = panel.querySelector("canvas");
    this.which = panel.querySelector("select.which");
    this.whole = panel.querySelector("input.whole");
    this.common = panel.querySelector("input.common");
    this.form = panel.querySelector("form");
    this.path = null;
    this.box = null;
    this.anchor = null;
    this.cursor = null;
    this.marked = false;  // whether a cross shows the cursor: when it is moved by keys
    this.ready = null;
    panel.hidden = false;
    this.listen();
  }
  listen() {
    const redraw = () => this.load().then(() => this.draw());
    this.which.addEventListener("change", () => { this.panel.classList.add("used"); redraw(); });
    this.whole.addEventListener("change", () => { this.panel.classList.add("used"); redraw(); });
    this.common.addEventListener("change", () => { this.panel.classList.add("used"); redraw(); });
    for (const button of this.table.querySelectorAll("button.pick")) {
      button.closest("tr").addEventListener("click", (event) => {
        if (event.target.closest("td details")) return;  // its events
        this.choose(button.dataset.path);
      });
    }
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.view || event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      this.anchor = this.cursor = this.place(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.view) return;
      this.cursor = this.place(event);
      this.read();
      if (this.marked) {
        this.marked = false;
        this.draw();
      }
      if (this.anchor) this.draw([this.anchor[0], this.cursor[0], this.anchor[1], this.cursor[1]]);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (!this.anchor) return;
      const [a, b] = [this.anchor, this.place(event)];
      this.anchor = null;
      // A click is no box
      if (Math.hypot(...[0, 1].map((k) => (a[k] - b[k]) * this.view.scale)) < 4) this.draw();
      else this.chooseBox([a[0], b[0], a[1], b[1]]);
    });
    canvas.addEventListener("pointercancel", () => { this.anchor = null; this.draw(); });
    canvas.addEventListener("keydown", (event) => this.press(event));
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      const corners = ["x0", "x1", "y0", "y1"].map((name) => numberOf(this.form.elements[name].value));
      if (corners.some(Number.isNaN)) this.say("Give all four edges of the box in mm, or drag one on the map.");
      else this.chooseBox(corners);
    });
    this.form.addEventListener("reset", () => this.clearBox());
    this.back = this.panel.querySelector("button.back");
    this.back.addEventListener("click", () => {
      const button = this.pick();
      button.focus({ preventScroll: true });
      button.scrollIntoView({ block: "center" });
    });
  }
  say(text) {
    this.panel.querySelector(".found").textContent = text;
  }
  load() {
    this.ready ||= (async () => {
      const held = JSON.parse(document.getElementById(this.panel.dataset.source).textContent);
      const data = JSON.parse(new TextDecoder().decode(await inflated(bytesOf(held.packed))));
      const powers = powersOf(await inflated(bytesOf(held.codes)));
      this.data = data;
      const stray = readMap(data.stray, powers);
      this.maps = { light: together(readMap(data.direct, powers), stray), stray };
      this.rest = readMap(data.rest, powers);
      this.others = data.others.map(([id, label, entry]) => ({ id, label, map: readMap(entry, powers) }));
      this.paths = Object.fromEntries(Object.entries(data.paths).map(([id, entry]) => [id, readMap(entry, powers)]));
      const [x0, x1, y0, y1] = data.extent;
      this.pixel = [(x1 - x0) / data.shape[1], (y1 - y0) / data.shape[0]];
    })();
    return this.ready;
  }
  current() {
    return this.which.value === "path" ? this.paths[this.path] : this.maps[this.which.value];
  }
  mm(map) {  // x0, x1, y0, y1 of a map
    const [x0, , y0] = this.data.extent, size = this.pixel.map((p) => p * map.pixels);
    return [x0 + map.column * size[0], x0 + (map.column + map.width) * size[0], y0 + map.row * size[1], y0 + (map.row + map.height) * size[1]];
  }
  window(map) {
    if (this.whole.checked || !map.width) return this.data.extent;
    const [a, b, c, d] = this.mm(map), x = (a + b) / 2, y = (c + d) / 2;
    const half = Math.max(0.55 * Math.max(b - a, d - c), 0.5 * FEWEST_CELLS * map.pixels * Math.max(...this.pixel));
    return [x - half, x + half, y - half, y + half];
  }
  draw(dragged) {
    const canvas = this.canvas, map = this.current(), view = this.window(map);
    const width = canvas.clientWidth;
    if (!width) return;  // folded; it is drawn when it is opened
    const room = [width - MARGIN.left - MARGIN.right, 420];
    const scale = Math.min(room[0] / (view[1] - view[0]), room[1] / (view[3] - view[2]));
    const size = [(view[1] - view[0]) * scale, (view[3] - view[2]) * scale], ratio = window.devicePixelRatio || 1;
    canvas.style.height = `${size[1] + MARGIN.top + MARGIN.bottom}px`;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round((size[1] + MARGIN.top + MARGIN.bottom) * ratio);
    this.view = { view, scale, size };
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = "#000";
    pen.fillRect(MARGIN.left, MARGIN.top, ...size);
    const cell = map.pixels ** 2 * this.pixel[0] * this.pixel[1];
    const own = () => logRange(map.power.map((p) => p / cell), DECADES[this.which.value]);
    const limits = (this.common.checked && this.shared.scales[this.which.value]) || own();  // a path has its own always
    const frame = new MapFrame(view, scale, size);
    if (limits) frame.paint(pen, map, this.mm(map), limits, cell, this.shared.palette);
    frame.axes(pen, limits, this.shared.palette);
    const box = dragged ? snapBox(dragged, this.data.extent, this.data.shape, this.data.grid).mm : this.box && this.box.mm;
    if (box) {
      const [x, y] = this.screen(box[0], box[3]), [x1, y1] = this.screen(box[1], box[2]);
      pen.lineWidth = 1.5;
      pen.strokeStyle = "#56b4e9";
      pen.strokeRect(x, y, x1 - x, y1 - y);
    }
    if (this.marked) {
      const [x, y] = this.screen(...this.cursor);
      pen.fillStyle = "#56b4e9";
      pen.fillRect(x - 9, y - 0.75, 18, 1.5);
      pen.fillRect(x - 0.75, y - 9, 1.5, 18);
    }
    const name = { light: "all light", stray: "without the direct image", path: `path ${this.path}` }[this.which.value];
    canvas.setAttribute("aria-label", `Irradiance map of field ${this.data.field}°, ${name}${limits ? `, log₁₀ scale ${raised(limits[0])} to ${raised(limits[1])} W/mm²` : ", dark"}`);
    this.panel.classList.add("ready");
    this.read();
  }
  screen(x, y) {
    const { view, scale, size } = this.view;
    return new MapFrame(view, scale, size).screen(x, y);
  }
  place(event) {  // of the pointer on the detector, mm
    const frame = this.canvas.getBoundingClientRect(), { view, scale, size } = this.view;
    return [view[0] + (event.clientX - frame.left - MARGIN.left) / scale, view[2] + (MARGIN.top + size[1] - event.clientY + frame.top) / scale];
  }
  onDetector([x, y]) {
    const [x0, x1, y0, y1] = this.data.extent;
    return x >= x0 && x <= x1 && y >= y0 && y <= y1;
  }
  read() {
    const out = this.panel.querySelector(".readout");
    const map = this.current();
    let text = "Drag a box on the map to see which paths light it; arrow keys move a cursor, with Shift a box grows.";
    if (this.cursor && this.onDetector(this.cursor)) {
      const [x, y] = this.cursor, [x0, x1, y0, y1] = this.mm(map);
      const c = Math.floor((x - x0) / (x1 - x0) * map.width), r = Math.floor((y - y0) / (y1 - y0) * map.height);
      const power = c >= 0 && r >= 0 && c < map.width && r < map.height ? map.power[r * map.width + c] : 0;
      text = `x ${printed(x)}, y ${printed(y)} mm: ${printed(power / (map.pixels ** 2 * this.pixel[0] * this.pixel[1]))} W/mm² (mean over ${map.pixels} × ${map.pixels} pixels)`;
    }
    out.textContent = text;
  }
  press(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (event.key === "Escape") {
      this.marked = false;
      this.form.reset();
    }
    if (!step || !this.view) return;
    event.preventDefault();
    const { extent, grid } = this.data, { view } = this.view;
    const old = this.cursor || [(view[0] + view[1]) / 2, (view[2] + view[3]) / 2];
    this.marked = true;
    this.cursor = old.map((v, k) => Math.min(Math.max(v + step[k] * grid * this.pixel[k], extent[2 * k]), extent[2 * k + 1]));
    if (event.shiftKey) {
      this.held ||= old;
      this.chooseBox([this.held[0], this.cursor[0], this.held[1], this.cursor[1]]);
    } else {
      this.held = null;
      this.draw();
    }
  }
  choose(path) {
    this.path = path;
    this.panel.classList.add("used");
    return this.load().then(() => {
      for (const button of this.table.querySelectorAll("button.pick")) button.setAttribute("aria-pressed", String(button.dataset.path === path));
      const option = this.which.querySelector('option[value="path"]');
      option.disabled = false;
      option.textContent = `path ${path}`;
      this.which.value = "path";
      this.whole.checked = !this.isSmall(this.current());
      this.draw();
      this.showEvents(this.pick().closest("tr"));
      this.showRays();
      this.back.hidden = false;
      const top = this.panel.getBoundingClientRect().top;
      if (top < 0 || top > window.innerHeight - 200) this.panel.scrollIntoView({ block: "start" });
    });
  }
  isSmall(map) {  // whether a path would be a dot on the whole detector
    const [x0, x1, y0, y1] = this.data.extent, [a, b, c, d] = this.mm(map);
    return map.width > 0 && Math.max((b - a) / (x1 - x0), (d - c) / (y1 - y0)) < SMALL_SHARE;
  }
  pick() {  // the button of the chosen path
    return this.table.querySelector(`button.pick[data-path="${this.path}"]`);
  }
  showEvents(row) {
    const details = row.querySelector("td.path details"), list = this.panel.querySelector("ol.events");
    this.events = details.lastChild.textContent.trim().split(/(?<=:[ATRItrij])\s+/).map((word) => [word.slice(0, word.lastIndexOf(":")), word.slice(-1)]);
    list.replaceChildren(...this.events.map(([surface, letter]) => {
      const item = document.createElement("li");
      item.textContent = `${surface}: ${this.shared.events[letter]}`;
      item.className = letter === "T" || letter === "A" ? "" : "turn";
      return item;
    }));
  }
  showRays() {
    const rays = this.path === null ? [] : this.data.rays[this.path] || [];
    const turns = new Set((this.events || []).filter(([, letter]) => letter !== "T" && letter !== "A").map(([surface]) => surface));
    const colour = (this.data.colours || {})[this.path] || OTHER_PATH;
    drawSection(this.panel.querySelector("svg.rays"), this.shared, rays, turns, colour);
    if (this.path === null) return;
    const label = this.pick().closest("tr").cells[3].textContent;
    const found = rays.length ? `${rays.length} of its rays, projected onto the section x = 0` : "too rare to draw: none of its rays is among those of the sample";
    this.panel.querySelector(".chosen").textContent = `Path ${this.path}, ${label}: ${found}. Thick orange: the surfaces where it turns.`;
  }
  chooseBox(corners) {
    this.panel.classList.add("used");
    return this.load().then(() => {
      const { extent, shape, grid } = this.data;
      const beyond = [0, 2].some((k) => Math.max(corners[k], corners[k + 1]) <= extent[k] || Math.min(corners[k], corners[k + 1]) >= extent[k + 1]);
      if (beyond) {
        const [a, b, c, d] = extent.map((v) => printed(v));
        this.say(`The box lies beside the detector, which has x ${a} … ${b}, y ${c} … ${d} mm.`);
        return this.draw();
      }
      this.box = snapBox(corners, extent, shape, grid);
      ["x0", "x1", "y0", "y1"].forEach((name, k) => { this.form.elements[name].value = short(this.box.mm[k], 6); });
      this.form.querySelector('button[type="reset"]').disabled = false;
      const rest = powerWithin(this.rest, this.box.pixels);
      const powers = Object.entries(this.paths).map(([id, map]) => [id, powerWithin(map, this.box.pixels)]);
      const total = powers.reduce((sum, pair) => sum + pair[1], rest), byPath = Object.fromEntries(powers);
      let fed = 0;
      for (const row of this.order) {
        const button = row.querySelector("button.pick"), power = button ? byPath[button.dataset.path] : 0;
        const cell = row.querySelector("td.inbox");
        row.dataset.aside = power > 0 ? "0" : "1";
        cell.dataset.v = String(power);
        cell.replaceChildren(power > 0 ? printed(power, 3) : "–");
        if (power > 0) {
          fed += 1;
          const share = document.createElement("small");
          share.textContent = `${printed(100 * power / total, 3)} % of it`;
          cell.append(share);
        }
      }
      this.table.classList.add("boxed");
      sortTable(this.table, [...this.table.tHead.rows[0].cells].findIndex((head) => head.classList.contains("inbox")), true);
      filterTable(this.table);
      const more = rest > 0 ? `, and ${printed(100 * rest / total, 3)} % of it come from ${this.below(rest, total)}` : "";
      const [x0, x1, y0, y1] = this.box.mm.map((v) => printed(v));
      this.say(`Box x ${x0} … ${x1}, y ${y0} … ${y1} mm: ${printed(total, 3)} W absorbed, ${fed} of ${this.order.length} paths of the table light it${more}.`);
      this.draw();
    });
  }
  below(rest, total) {  // what lights the chosen box and is not in the table
    const found = this.others.map((path) => [path, powerAbout(path.map, this.box.pixels)]).filter((pair) => pair[1] > 0);
    found.sort((a, b) => b[1] - a[1]);
    if (!found.length) return "paths below the table";
    const named = found.slice(0, 3).map(([{ id, label }, power]) => `path ${id} (${label}, about ${printed(100 * Math.min(power, rest) / total, 2)} %)`);
    const more = found.length - named.length;
    return `paths below the table: ${named.join(", ")}${more ? ` and ${more} more` : ""}`;
  }
  clearBox() {
    this.box = this.held = null;
    this.table.classList.remove("boxed");
    this.table.tHead.rows[0].querySelectorAll("th").forEach((head) => head.removeAttribute("aria-sort"));
    for (const row of this.order) {
      delete row.dataset.aside;
      this.table.tBodies[0].append(row);
    }
    filterTable(this.table);
    this.form.querySelector('button[type="reset"]').disabled = true;
    this.say("");
    if (this.data) this.draw();
  }
}

// Without DecompressionStream (browsers before 2023) the page stays as it is on paper
const pageData = typeof DecompressionStream === "undefined" ? null : document.getElementById("data-page");
if (pageData) {
  const shared = JSON.parse(pageData.textContent);
  shared.palette = bytesOf(shared.colours);
  const drawn = (explorer) => explorer.load().then(() => { explorer.draw(); explorer.showRays(); });
  const explorers = new Map([...document.querySelectorAll("div.explorer")].map((panel) => [panel, new Explorer(panel, shared)]));
  // What is far away is drawn when it comes near
  const watch = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((entry) => entry.isIntersecting)) {
      watch.unobserve(entry.target);
      drawn(explorers.get(entry.target));
    }
  }, { rootMargin: "600px" });
  explorers.forEach((explorer, panel) => {
    watch.observe(panel);
    const folded = panel.closest("details");
    if (folded) folded.addEventListener("toggle", () => { if (folded.open && explorer.data) explorer.draw(); });
  });
  const redraw = () => explorers.forEach((explorer) => { if (explorer.data) explorer.draw(); });
  window.addEventListener("resize", redraw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}
