// The live explorer, in a page of its own or in a notebook. A transport has call(name, given), which answers with JSON,
// and follow(onView, onEnd, since), which tells what is new. What a report draws with stands before this, see drawing.js.
const DECADES_OF_STRAY = 6;
const STEPS_OF_SLIDER = 1000;
const RAY_COLOUR = "#d55e00";

function make(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}
function power(value) {
  return value === null ? "–" : `${printed(value, 4)} W`;
}
class LiveExplorer {
  constructor(root, transport, page) {
    Object.assign(this, { root, transport, page, chosen: null, moves: {}, sent: {}, sending: false, answers: 0 });
    this.page.palette = bytesOf(page.colours);
    this.build();
    this.show(page.view);
  }
  build() {
    const part = (name, ...children) => make("section", { className: name }, ...children);
    this.label = make("strong", { className: "label" });
    this.status = make("p", { className: "status" });
    this.status.setAttribute("role", "status");
    this.busy = make("span", { className: "busy" });
    this.difference = make("p", { className: "difference" });
    this.leftOut = make("ul", { className: "left-out" });
    this.status.append(this.label, this.busy);
    this.numbers = make("dl", { className: "numbers" });
    this.said = make("p", { className: "said" });
    this.said.setAttribute("role", "status");
    this.canvas = make("canvas", { className: "map" });
    this.canvas.setAttribute("role", "img");
    this.table = make("table", { className: "paths" });
    this.rank = make("select", {}, make("option", { value: "rms", textContent: "RMS irradiance" }), make("option", { value: "power", textContent: "power" }));
    this.rank.setAttribute("aria-label", "worst by");
    this.rank.addEventListener("change", () => {
      this.showNumbers(this.view);
      this.showPaths(this.view);
    });
    this.more = make("p", { className: "more" });
    this.svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.svg.setAttribute("class", "rays");
    this.svg.setAttribute("role", "img");
    this.svg.setAttribute("aria-label", "Section of the system in the y-z plane");
    this.detail = make("div", { className: "detail" }, make("p", { textContent: "Choose a path of the table to see its rays and what would weaken it." }));
    this.inputs = {};
    const controls = part("controls", make("h2", { textContent: "Controls" }), ...this.groups(), this.buttons());
    this.root.classList.add("mistray-explorer");
    this.root.replaceChildren(make("div", { className: "grid" },
      make("h1", { textContent: this.page.title }),
      controls,
      part("answer", this.status, this.difference, this.leftOut, this.numbers, this.said),
      part("picture", make("h2", { textContent: "Stray light on the detector" }), this.canvas),
      part("system", make("h2", { textContent: "Rays of the chosen path" }), this.svg, this.detail),
      part("list", make("h2", { textContent: "Worst paths" }), make("label", {}, "by ", this.rank), make("div", { className: "wide" }, this.table), this.more),
    ));
    this.watch = new ResizeObserver(() => this.drawMap());
    this.watch.observe(this.canvas.parentElement);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.drawMap());
  }
  groups() {
    const titles = { light: "Light", coating: "Coatings", number: "Numbers" };
    const kinds = { field: "light", wavelength: "light", coating: "coating", layers: "coating", number: "number" };
    return Object.entries(titles).map(([group, title]) => {
      const own = this.page.controls.filter((control) => kinds[control.kind] === group);
      if (!own.length) return "";
      return make("fieldset", {}, make("legend", { textContent: title }), ...own.map((control) => this.control(control)));
    });
  }
  control(control) {
    const text = make("span", { className: "name", textContent: control.label, title: control.surfaces.join(", ") });
    const shown = make("output", {});
    if (control.choices.length) {
      const input = make("select", { name: control.name }, ...control.choices.map((choice) => make("option", { textContent: choice, value: choice })));
      input.addEventListener("change", () => this.move(control.name, input.value));
      this.inputs[control.name] = { set: (value) => { input.value = value; }, input };
      return make("label", {}, text, input);
    }
    const ends = control.log ? [Math.log(control.low), Math.log(control.high)] : [control.low, control.high];
    const valueAt = (place) => {
      if (place <= 0) return control.low;
      if (place >= STEPS_OF_SLIDER) return control.high;
      const value = ends[0] + (ends[1] - ends[0]) * place / STEPS_OF_SLIDER;
      return Number((control.log ? Math.exp(value) : value).toPrecision(4 + (control.log ? 0 : 2)));
    };
    const clamped = (value) => Math.min(Math.max(value, control.low), control.high);
    const tell = (value) => { shown.textContent = `${printed(value)}${control.unit ? ` ${control.unit}` : ""}`; };
    const input = make("input", { type: "range", name: control.name, min: 0, max: STEPS_OF_SLIDER, step: 1 });
    const set = (value) => {
      input.value = String(Math.round(STEPS_OF_SLIDER * ((control.log ? Math.log(value) : value) - ends[0]) / (ends[1] - ends[0])));
      input.setAttribute("aria-valuetext", `${printed(value)} ${control.unit}`);
      tell(value);
    };
    input.addEventListener("input", () => {
      const value = clamped(valueAt(Number(input.value)));
      tell(value);
      this.move(control.name, value);
    });
    this.inputs[control.name] = { set, input };
    return make("label", {}, text, input, shown);
  }
  buttons() {
    const button = (text, action) => {
      const made = make("button", { type: "button", textContent: text });
      made.addEventListener("click", () => action().catch((error) => this.say(error.message)));
      return made;
    };
    const save = (name, what) => async () => {
      const { path } = await this.transport.call(name);
      this.say(`${what} saved as ${path}`);
    };
    return make("p", { className: "buttons" },
      button("Reset", async () => this.show(await this.transport.call("reset"))),
      button("Save scene", save("save_scene", "Scene")),
      button("Save study", save("save_study", "Study")));
  }
  say(text) {
    this.said.textContent = text;
  }
  async move(name, value) {  // while one answer is awaited, later values of a slider go over earlier ones
    this.moves[name] = value;
    if (this.sending) return;
    this.sending = true;
    try {
      while (Object.keys(this.moves).length) {
        const values = this.sent = this.moves;
        this.moves = {};
        const view = await this.transport.call("move", { values });
        this.sent = {};
        this.show(view);
        this.answers += 1;
        this.root.dataset.answers = this.answers;
      }
      this.say("");
    } catch (error) {
      this.say(error.message);
      this.moves = {};
      for (const [known, old] of Object.entries(this.view.values)) this.inputs[known].set(old);
    } finally {
      this.sent = {};
      this.sending = false;
    }
  }
  show(view) {
    if (this.view && view.version <= this.view.version) return;  // it came both ways
    this.view = view;
    for (const [name, value] of Object.entries(view.values)) {
      const known = this.inputs[name];
      if (known && !(name in this.moves) && !(name in this.sent) && known.input !== this.held()) known.set(value);
    }
    this.root.dataset.label = view.label;
    this.root.dataset.version = view.version;
    this.root.dataset.busy = view.busy;
    this.label.textContent = view.label;
    this.busy.textContent = view.busy ? ` … ${view.busy}` : "";
    this.leftOut.replaceChildren(...(view.left_out || []).map((text) => make("li", { textContent: text })));
    if (view.message) this.say(view.message);
    const d = view.difference;
    this.difference.textContent = d ? `The estimate was ${printed(d.estimate_W)} W, ${d.percent >= 0 ? "+" : "−"}${printed(Math.abs(d.percent), 2)} % from the trace, ${view.shown.stray_W} W.` : "";
    if (!view.stray_W) return;
    this.showNumbers(view);
    this.showPaths(view);
    this.drawMap();
    if (this.chosen && view.label === "traced" && view.traces !== this.traces) this.choose(this.chosen);
    this.traces = view.traces;
  }
  held() {  // the slider under the hand of the user keeps its place
    const active = this.root.getRootNode().activeElement;
    return active && active.type === "range" && active.matches(":active") ? active : null;
  }
  worst(view) {
    const rank = `rank_${this.rank.value}`;
    return view.paths.filter((path) => path[rank] < view.listed).sort((a, b) => a[rank] - b[rank]);
  }
  showNumbers(view) {
    const [worst] = this.worst(view);
    const rows = [
      ["stray light", `${view.shown.stray_W} W absorbed`],
      ["stray over direct", view.ratio[0] === null ? "no direct image here" : view.shown.ratio],
      ["direct image", `${view.shown.direct_W} W absorbed`],
      ["worst path", worst ? `${worst.label}, ${printed(worst.percent, 3)} % of the stray light` : "none"],
      ...(view.remedy ? [["change first", `${view.remedy.surface}: it ${view.remedy.deed} ${printed(view.remedy.percent, 3)} % of the stray light${view.label === "traced" ? "" : " of the last trace"}`]] : []),
    ];
    this.numbers.replaceChildren(...rows.flatMap(([name, text]) => [make("dt", { textContent: name }), make("dd", { textContent: text })]));
  }
  showPaths(view) {
    const head = make("thead", {}, make("tr", {}, ...["path", "kind", "power [W absorbed]", "% of stray", "rms radius [mm]"].map((text) => make("th", { textContent: text, scope: "col" }))));
    const paths = this.worst(view);
    const rows = paths.map((path) => {
      const pick = make("button", { type: "button", textContent: path.label });
      pick.setAttribute("aria-pressed", String(this.isChosen(path)));
      pick.addEventListener("click", () => this.choose(path));
      const cells = [path.kind, path.power, printed(path.percent, 3), path.rms_radius_mm === null ? "–" : printed(path.rms_radius_mm, 3)];
      return make("tr", {}, make("td", {}, pick), ...cells.map((text) => make("td", { textContent: text })));
    });
    const focused = this.table.contains(this.root.getRootNode().activeElement);
    this.table.replaceChildren(head, make("tbody", {}, ...rows));
    if (focused) this.table.querySelector('button[aria-pressed="true"]')?.focus();
    this.more.textContent = view.count > paths.length ? `and ${view.count - paths.length} more paths` : "";
  }
  isChosen({ events, source }) {
    return events === this.chosen?.events && source === this.chosen?.source;
  }
  async choose({ events, source }) {
    this.chosen = { events, source };
    try {
      const found = await this.transport.call("detail", { events, source });
      if (this.isChosen({ events, source })) this.showDetail(found);
    } catch (error) {
      this.say(error.message);
    }
    this.showPaths(this.view);
  }
  showDetail(found) {
    const turns = new Set(found.turns.map((turn) => turn.surface));
    drawSection(this.svg, this.page, found.rays, turns, RAY_COLOUR);
    const list = make("ol", { className: "events" }, ...found.events.map(([surface, what, turn]) => make("li", { textContent: `${surface}: ${what}`, className: turn ? "turn" : "" })));
    const shares = found.turns.map((turn) => make("li", { textContent: `${printed(turn.percent, 3)} % of all stray light turns at ${turn.surface}` }));
    const now = this.view.stray_W[0];
    const remedies = found.remedies.map((one) => {
      const text = one.choice === one.now
        ? `${one.part}: ${one.choice} is the best of these coatings already`
        : `${one.part}: ${one.choice} leaves ${power(one.path_W)} of this path and ${power(one.stray_W)} of all stray light (now ${power(found.power_W)} and ${power(now)})`;
      const item = make("li", { textContent: text });
      if (one.choice !== one.now) {
        const apply = make("button", { type: "button", textContent: "put on" });
        apply.addEventListener("click", () => this.move(one.control, one.choice));
        item.append(" ", apply);
      }
      return item;
    });
    const rays = found.rays.length ? `${found.rays.length} of its rays` : "too rare for the sample of rays: none is drawn";
    this.detail.replaceChildren(
      make("p", { textContent: `${rays}. Thick orange: the surfaces where it turns.` }),
      make("ul", { className: "turns" }, ...shares),
      make("h3", { textContent: "What would weaken it" }),
      remedies.length ? make("ul", { className: "remedies" }, ...remedies) : make("p", { textContent: "No coating of a clear surface: look at the numbers above, or at mistray objects." }),
      make("details", {}, make("summary", { textContent: "all its events" }), list));
  }
  drawMap() {
    const map = this.view && this.view.map;
    if (!map || !this.canvas.parentElement.clientWidth) return;
    const powers = powersOf(bytesOf(map.codes)), [x0, x1, y0, y1] = map.extent;
    const width = this.canvas.parentElement.clientWidth, ratio = window.devicePixelRatio || 1;
    const scale = Math.min((width - MARGIN.left - MARGIN.right) / (x1 - x0), 380 / (y1 - y0));
    const size = [(x1 - x0) * scale, (y1 - y0) * scale];
    const cell = (x1 - x0) / map.width * (y1 - y0) / map.height;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round((size[1] + MARGIN.top + MARGIN.bottom) * ratio);
    this.canvas.style.height = `${size[1] + MARGIN.top + MARGIN.bottom}px`;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = "#000";
    pen.fillRect(MARGIN.left, MARGIN.top, ...size);
    const frame = new MapFrame(map.extent, scale, size);
    const limits = logRange(powers.map((value) => value / cell), DECADES_OF_STRAY);
    if (limits) frame.paint(pen, { width: map.width, height: map.height, power: powers }, map.extent, limits, cell, this.page.palette);
    frame.axes(pen, limits, this.page.palette);
    this.canvas.setAttribute("aria-label", `Irradiance map of the stray light, ${this.view.label}${limits ? `, log₁₀ scale ${raised(limits[0])} to ${raised(limits[1])} W/mm²` : ", dark"}`);
  }
  ended() {
    this.root.dataset.ended = "1";
    this.busy.textContent = " … the explorer has ended";
    for (const input of this.root.querySelectorAll("input, select, button")) input.disabled = true;
  }
}

export async function mount(root, transport) {
  const page = await transport.call("page");
  const explorer = new LiveExplorer(root, transport, page);
  drawSection(explorer.svg, page, [], new Set(), RAY_COLOUR);
  transport.follow((view) => explorer.show(view), () => explorer.ended(), page.view.version);
  return explorer;
}

// In a notebook: calls are messages of the widget, whose answers carry their numbers.
async function render({ model, el }) {
  const root = document.createElement("div"), waiting = new Map(), own = crypto.randomUUID();
  let count = 0, onView = () => {};
  const receive = (message) => {
    if (message.view) return onView(message.view);
    const asked = waiting.get(message.id);
    if (!asked) return;  // of another place that shows the same widget
    waiting.delete(message.id);
    if (message.error) asked.reject(new Error(message.error));
    else asked.resolve(message.found);
  };
  const call = (name, given = {}) => new Promise((resolve, reject) => {
    const id = `${own} ${count += 1}`;
    waiting.set(id, { resolve, reject });
    model.send({ id, call: name, given });
  });
  model.on("msg:custom", receive);
  el.append(root);
  await mount(root, { call, follow: (told) => { onView = told; } });
  return () => model.off("msg:custom", receive);
}
export default { render };
