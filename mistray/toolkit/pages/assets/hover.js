// Plots of class "hover": the pointer, or the arrow keys, choose a place on the x axis; its values stand beside it.
function nearest(places, x) {
  let best = 0;
  places.forEach((place, k) => { if (Math.abs(place - x) < Math.abs(places[best] - x)) best = k; });
  return best;
}
for (const plot of document.querySelectorAll("div.hover")) {
  const svg = plot.querySelector("svg"), tip = plot.querySelector(".tip");
  const data = JSON.parse(plot.querySelector("script").textContent);
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  line.setAttribute("class", "cursor");
  svg.append(line);
  let chosen = -1;
  const show = (k) => {
    chosen = k;
    const x = data.x[k];
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", data.area[1]], ["y2", data.area[3]]]) line.setAttribute(name, value);
    line.style.display = "inline";
    tip.replaceChildren();
    const table = document.createElement("table"), caption = table.createCaption();
    caption.textContent = data.titles[k];
    for (const [name, value] of data.values[k]) {
      const row = table.insertRow();
      row.insertCell().textContent = name;
      row.insertCell().textContent = value;
    }
    tip.append(table);
    tip.hidden = false;
    // In the upper half, on the side with more room
    const box = plot.getBoundingClientRect(), at = (x - data.view[0]) / data.view[2] * box.width;
    const right = at > box.width / 2;
    tip.style.left = right ? "" : `${at + 12}px`;
    tip.style.right = right ? `${box.width - at + 12}px` : "";
  };
  const hide = () => { line.style.display = "none"; tip.hidden = true; };
  hide();
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    show(nearest(data.x, data.view[0] + (event.clientX - box.left) / box.width * data.view[2]));
  });
  svg.addEventListener("pointerleave", hide);
  plot.addEventListener("blur", hide);
  plot.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === "Escape") hide();
    if (step === undefined) return;
    event.preventDefault();
    show(Math.min(Math.max(chosen + step, 0), data.x.length - 1));
  });
}
