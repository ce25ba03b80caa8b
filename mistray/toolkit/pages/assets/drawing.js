// Maps of the detector and the section of a system, as reports and the live explorer draw them.
function powersOf(bytes) {
  const count = bytes.length / 2, powers = new Float64Array(count);
  for (let k = 0; k < count; k += 1) {
    const code = bytes[k] * 256 + bytes[count + k];
    powers[k] = code === 0 ? 0 : 10 ** (code / 600 - 100);
  }
  return powers;
}
function logRange(values, decades) {  // whole powers of ten: floor and top, as mistray.toolkit.irradiance.log_range
  const lit = Float64Array.from(values).filter((v) => v > 0).sort();
  if (!lit.length) return null;
  const top = Math.ceil(Math.log10(lit[lit.length - 1]));
  const floor = Math.floor(Math.log10(lit[Math.floor(0.01 * (lit.length - 1))]));
  return [Math.max(Math.min(floor, top - 1), top - decades), top];
}
function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999), found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) found.push(Number((k * step).toPrecision(12)));
  return found;
}
function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}
function raised(exponent) {  // a power of ten in print
  return `10${[...String(exponent)].map((sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]).join("")}`;
}
function printed(value, digits = 4) {  // a number in print; fields of a form hold the short one
  const [mantissa, exponent] = short(value, digits).split("e");
  const number = mantissa.replace("-", "−");
  return exponent === undefined ? number : `${number === "1" ? "" : `${number}·`}${raised(Number(exponent))}`;
}
function ink(canvas) {  // colour of lines and letters on the page, which may be dark
  return (typeof getComputedStyle === "function" && getComputedStyle(canvas).getPropertyValue("--ink").trim()) || "#1b1f24";
}
function short(value, digits = 4) {
  return value === 0 ? "0" : Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5 ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1);
}

const STYLES = { glass: ["#4a6a86", 0.9], structure: ["#7a7a7a", 1.4], mirror: ["var(--ink, #333)", 1.6], detector: ["var(--ink, #000)", 2.4] };
const MARGIN = { left: 52, right: 74, top: 8, bottom: 36 };
const TURN = "#e69f00";  // of the surfaces where a path turns; no path of the layout has it

function svgPath(points, attributes) {
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  let d = "";
  for (let k = 0; k < points.length; k += 2) d += `${k ? "L" : "M"}${points[k]} ${-points[k + 1]}`;
  for (const [name, value] of Object.entries({ d, fill: "none", "vector-effect": "non-scaling-stroke", ...attributes })) {
    if (String(value).startsWith("var(")) path.style.setProperty(name, value);
    else path.setAttribute(name, value);
  }
  return path;
}

class MapFrame {  // a map on a canvas: view x0, x1, y0, y1 in mm, scale in pixels for each, size in pixels
  constructor(view, scale, size) {
    Object.assign(this, { view, scale, size });
  }
  screen(x, y) {
    const { view, scale, size } = this;
    return [MARGIN.left + (x - view[0]) * scale, MARGIN.top + size[1] - (y - view[2]) * scale];
  }
  paint(pen, map, [x0, x1, y0, y1], limits, cell, colours) {  // cell: its area, mm²
    const picture = new ImageData(map.width, map.height);
    for (let r = 0; r < map.height; r += 1) {
      for (let c = 0; c < map.width; c += 1) {
        const level = (Math.log10(map.power[r * map.width + c] / cell) - limits[0]) / (limits[1] - limits[0]);
        const to = 4 * ((map.height - 1 - r) * map.width + c), from = 3 * Math.min(Math.max(Math.round(255 * level), 0), 255);
        for (let k = 0; k < 3; k += 1) picture.data[to + k] = level >= 0 ? colours[from + k] : 0;
        picture.data[to + 3] = 255;
      }
    }
    const small = document.createElement("canvas");
    [small.width, small.height] = [map.width, map.height];
    small.getContext("2d").putImageData(picture, 0, 0);
    const [x, y] = this.screen(x0, y1), [right, bottom] = this.screen(x1, y0);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, MARGIN.top, ...this.size);
    pen.clip();
    pen.imageSmoothingEnabled = false;
    pen.drawImage(small, x, y, right - x, bottom - y);
    pen.restore();
  }
  axes(pen, limits, colours) {
    const { view, size } = this, bottom = MARGIN.top + size[1];
    pen.fillStyle = pen.strokeStyle = ink(pen.canvas);
    pen.lineWidth = 1;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const x of ticks(view[0], view[1], Math.max(size[0] / 70, 2))) {
      const at = this.screen(x, view[2])[0];
      pen.fillRect(at, bottom, 1, 4);
      pen.fillText(printed(x), at, bottom + 6);
    }
    pen.fillText("x [mm]", MARGIN.left + size[0] / 2, bottom + 21);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const y of ticks(view[2], view[3], Math.max(size[1] / 50, 2))) {
      const at = this.screen(view[0], y)[1];
      pen.fillRect(MARGIN.left - 4, at, 4, 1);
      pen.fillText(printed(y), MARGIN.left - 6, at);
    }
    pen.save();
    pen.translate(10, MARGIN.top + size[1] / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText("y [mm]", 0, 0);
    pen.restore();
    if (!limits) {
      pen.fillStyle = "#fff";
      pen.textAlign = "center";
      pen.fillText("no light", MARGIN.left + size[0] / 2, MARGIN.top + size[1] / 2);
      return;
    }
    const left = MARGIN.left + size[0] + 10;
    for (let k = 0; k < 256; k += 1) {
      pen.fillStyle = `rgb(${colours[3 * k]},${colours[3 * k + 1]},${colours[3 * k + 2]})`;
      pen.fillRect(left, bottom - size[1] * (k + 1) / 256, 12, size[1] / 256 + 1);
    }
    pen.fillStyle = ink(pen.canvas);
    pen.textAlign = "left";
    const each = Math.ceil((limits[1] - limits[0]) / 8);
    for (let power = limits[0]; power <= limits[1]; power += each) {
      pen.fillText(raised(power), left + 16, Math.min(Math.max(bottom - size[1] * (power - limits[0]) / (limits[1] - limits[0]), MARGIN.top + 5), bottom - 5));
    }
    pen.textBaseline = "top";
    pen.fillText("W/mm²", left, bottom + 6);
  }
}

function drawSection(svg, { bounds, glass, surfaces }, rays, turns, colour) {  // turns: names of surfaces to mark
  const [z0, y0, z1, y1] = bounds;
  const margin = 0.05 * Math.max(z1 - z0, y1 - y0), wide = z1 - z0 + 3 * margin, high = y1 - y0 + 2 * margin;
  const below = 0.1 * Math.max(high, 0.55 * wide);  // room for the scale
  svg.setAttribute("viewBox", [z0 - 2 * margin, -y1 - margin, wide, high + below].join(" "));
  const parts = glass.map((body) => svgPath(body, { fill: "var(--glass, #dbe9f4)" }));
  for (const surface of surfaces) {
    const [stroke, width] = STYLES[surface.kind] || STYLES.structure, marked = turns.has(surface.name);
    for (const line of surface.lines) {
      const path = svgPath(line, { stroke: marked ? TURN : stroke, "stroke-width": marked ? 3 : width });
      const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
      title.textContent = surface.name;
      path.append(title);
      parts.push(path);
    }
  }
  for (const ray of rays) parts.push(svgPath(ray, { stroke: colour, "stroke-width": 0.9, "stroke-opacity": 0.9, class: "ray" }));
  const [, bar] = ticks(0, wide, 5), left = z0 - margin, base = -y0 + margin + 0.3 * below;
  parts.push(svgPath([left, -base, left + bar, -base], { stroke: "var(--ink, #1b1f24)", "stroke-width": 2 }));
  const text = document.createElementNS("http://www.w3.org/2000/svg", "text");
  text.textContent = `${printed(bar)} mm (z to the right, y up)`;
  for (const [name, value] of Object.entries({ x: left, y: base + 0.6 * below, "font-size": 0.45 * below })) text.setAttribute(name, value);
  text.style.fill = "var(--ink, #1b1f24)";
  svg.replaceChildren(...parts, text);
}
