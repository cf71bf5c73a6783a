// Figures that are zoomed and read out. What is drawn is matplotlib's SVG: the script moves its
// parts, and finds values where they are drawn. The JSON beside it says what the axes are.
const NEAR = 16; // CSS pixels from which on the pointer is at a mark

class Plot {
  constructor(figure) {
    this.figure = figure;
    this.svg = figure.querySelector("svg");
    this.frame = figure.querySelector(".plot");
    const told = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
    this.panels = told.map((panel) => new Panel(panel, this.svg));
    if (!this.panels.length) return;
    this.over = create("g", { class: "over" }, this.svg);
    this.readout = document.createElement("div");
    this.readout.className = "readout";
    this.readout.setAttribute("role", "status");
    this.readout.hidden = true;
    this.frame.append(this.readout);
    this.addButtons();
    const on = (name, act, options) => this.frame.addEventListener(name, (event) => act.call(this, event), options);
    on("pointermove", this.move);
    on("pointerdown", this.press);
    on("pointerup", this.release);
    on("pointercancel", this.leave);
    on("pointerleave", this.leave);
    on("dblclick", () => this.reset());
    on("wheel", this.wheel, { passive: false });
    on("keydown", this.key);
    on("blur", () => this.hide());
  }
  addButtons() {
    const bar = document.createElement("div");
    bar.className = "tools";
    for (const [text, says, act] of [["+", "Zoom in", () => this.scaleBy(0.6)], ["−", "Zoom out", () => this.scaleBy(1 / 0.6)], ["Reset", "Show all of the figure", () => this.reset()]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.title = says;
      button.setAttribute("aria-label", says);
      button.addEventListener("click", act);
      bar.append(button);
    }
    const hint = document.createElement("span");
    if (this.figure === document.querySelector("figure")) hint.textContent = "Point at the figure to read values; drag to zoom, Shift and drag to move, double-click to reset; or the keys ← → ↑ ↓ + − 0.";
    bar.append(hint);
    this.figure.querySelector("figcaption").after(bar);
  }
  point(event) {
    const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return [p.x, p.y];
  }
  find([x, y]) { return this.panels.find((panel) => panel.inside(x, y)); }
  apply() {
    for (const panel of this.panels) panel.show();
    this.frame.classList.toggle("zoomed", this.panels.some((p) => p.x.zoomed || p.y.zoomed));
    this.hide();
  }
  // Panels that share an axis are zoomed together.
  zoom(panel, letter, first, last) {
    for (const one of this.panels) if (one[letter].group === panel[letter].group) one[letter].zoom(first, last);
  }
  scaleBy(factor, centre) {
    const panel = centre?.panel ?? this.last ?? this.panels[0], done = new Set();
    for (const one of centre ? [panel] : this.panels)
      for (const letter of ["x", "y"]) {
        const axis = one[letter], key = letter + axis.group;
        if (done.has(key)) continue;
        done.add(key);
        const [a, b] = axis.shown, at = centre ? centre[letter] : (a + b) / 2;
        this.zoom(one, letter, at + (a - at) * factor, at + (b - at) * factor);
      }
    this.apply();
  }
  reset() {
    for (const panel of this.panels) { panel.x.shown = [0, 1]; panel.y.shown = [0, 1]; }
    this.apply();
  }
  press(event) {
    const at = this.point(event), panel = this.find(at);
    if (!panel || event.button !== 0) return;
    this.last = panel;
    const touch = event.pointerType === "touch";
    if (touch && !panel.x.zoomed && !panel.y.zoomed) return this.read(panel, at);
    this.drag = { panel, at, pan: touch || event.shiftKey, x: [...panel.x.shown], y: [...panel.y.shown] };
    this.frame.setPointerCapture(event.pointerId);
    event.preventDefault();
    this.frame.focus({ preventScroll: true });
  }
  move(event) {
    const at = this.point(event);
    if (!this.drag) {
      const panel = this.find(at);
      return panel ? this.read(panel, at) : this.hide();
    }
    const { panel, at: start, pan } = this.drag, [left, top, right, bottom] = panel.box;
    if (pan) {
      for (const [i, letter] of ["x", "y"].entries()) {
        const axis = panel[letter], [a, b] = this.drag[letter];
        const by = ((at[i] - start[i]) / (axis.to - axis.from)) * (b - a);
        this.zoom(panel, letter, a - by, b - by);
      }
      return this.apply();
    }
    this.hide();
    const x = Math.min(Math.max(at[0], left), right), y = Math.min(Math.max(at[1], top), bottom);
    this.drag.to = [x, y];
    create("rect", { class: "box", x: Math.min(x, start[0]), y: Math.min(y, start[1]), width: Math.abs(x - start[0]), height: Math.abs(y - start[1]) }, this.over);
  }
  release() {
    const drag = this.drag;
    this.drag = undefined;
    this.over.replaceChildren();
    if (!drag?.to || drag.pan) return;
    // A narrow box zooms along its long side alone.
    const sizes = [0, 1].map((i) => Math.abs(drag.to[i] - drag.at[i])), { panel } = drag;
    if (Math.max(...sizes) < 6) return;
    const spans = ["x", "y"].map((letter, i) => [panel[letter].at(drag.at[i]), panel[letter].at(drag.to[i])]);
    for (const [i, letter] of ["x", "y"].entries())
      if (sizes[i] >= 6 || sizes[i] > 0.3 * sizes[1 - i]) this.zoom(panel, letter, ...spans[i]);
    this.apply();
  }
  wheel(event) {
    if (!event.ctrlKey) return; // the wheel alone scrolls the page
    const at = this.point(event), panel = this.find(at);
    if (!panel) return;
    event.preventDefault();
    this.scaleBy(event.deltaY < 0 ? 0.8 : 1.25, { panel, x: panel.x.at(at[0]), y: panel.y.at(at[1]) });
  }
  leave() { if (!this.drag) this.hide(); }
  hide() {
    this.readout.hidden = true;
    this.over.replaceChildren();
  }
  // All that can be read: each mark, and each corner of a line.
  get stops() {
    return this.panels.flatMap((panel) => panel.parts.filter((part) => part.line && part.x && part.y && part.points.length)
      .map((part) => ({ panel, part, points: [...part.points].sort((a, b) => a[0] - b[0]) })));
  }
  key(event) {
    const { key } = event;
    if (["+", "="].includes(key)) this.scaleBy(0.6);
    else if (["-", "−"].includes(key)) this.scaleBy(1 / 0.6);
    else if (["0", "Escape"].includes(key)) this.reset();
    else if (key.startsWith("Arrow")) this.step(key);
    else return;
    event.preventDefault();
  }
  step(key) {
    const stops = this.stops;
    if (!stops.length) return;
    const here = (this.here ??= { line: 0, point: -1 });
    if (key === "ArrowDown" || key === "ArrowUp") {
      here.line = (here.line + (key === "ArrowDown" ? 1 : -1) + stops.length) % stops.length;
      here.point = Math.max(0, Math.min(here.point, stops[here.line].points.length - 1));
    } else {
      const { points } = stops[here.line];
      here.point = Math.min(Math.max(here.point + (key === "ArrowRight" ? 1 : -1), 0), points.length - 1);
    }
    const { panel, part, points } = stops[here.line], [a, b] = panel.x.map, [c, d] = panel.y.map;
    this.tell(panel, part, points[here.point], [a * points[here.point][0] + b, c * points[here.point][1] + d]);
  }
  read(panel, at) {
    const size = this.svg.getScreenCTM().a, [a, b] = panel.x.map, [c, d] = panel.y.map;
    let best = NEAR / size, found;
    for (const part of panel.parts) {
      if (!part.isMarks || !part.x || !part.y) continue;
      for (const point of part.points) {
        const away = Math.hypot(a * point[0] + b - at[0], c * point[1] + d - at[1]);
        if (away < best) [best, found] = [away, { part, point }];
      }
    }
    if (found) return this.tell(panel, found.part, found.point, [a * found.point[0] + b, c * found.point[1] + d]);
    const cell = this.readMap(panel, at);
    if (cell) return this.display(at, cell, []);
    const x = (at[0] - b) / a, lines = [];
    for (const part of panel.parts) {
      if (!part.line || part.isMarks || !part.x || !part.y) continue;
      const y = part.cross(x);
      if (y === undefined || !panel.inside(at[0], c * y + d)) continue;
      lines.push({ part, y, away: Math.abs(c * y + d - at[1]) });
    }
    lines.sort((one, other) => one.away - other.away);
    const [name, unit] = split(panel.x.label), [what, unitY] = split(panel.y.label);
    const said = [`${name || "x"}: ${panel.x.say(panel.x.value(panel.x.at(at[0])))}${unit}`];
    const value = (y) => panel.y.say(panel.y.value((y - panel.y.from) / (panel.y.to - panel.y.from))) + unitY;
    if (!lines.length) said.push(`${what || "y"}: ${panel.y.say(panel.y.value(panel.y.at(at[1])))}${unitY}`);
    const marks = lines.slice(0, 8).map(({ part, y }) => ({ colour: part.colour, at: [at[0], c * y + d], text: `${part.name || what || "line"}: ${value(y)}` }));
    this.display(at, said, marks, panel);
  }
  readMap(panel, at) {
    const bar = panel.bars.find(([left, right, low, high]) => {
      const [x, y] = [panel.x.value(panel.x.at(at[0])), panel.y.value(panel.y.at(at[1]))];
      return x >= Math.min(left, right) && x <= Math.max(left, right) && y >= Math.min(low, high) && y <= Math.max(low, high);
    });
    if (bar) return [panel.y.say((bar[2] + bar[3]) / 2), `${split(panel.x.label)[0]}: ${write(bar[1])}${split(panel.x.label)[1]}`];
    if (!panel.map) return undefined;
    const { x, y, shape, values } = panel.map, put = [];
    for (const [span, n, axis, p] of [[x, shape[1], panel.x, at[0]], [y, shape[0], panel.y, at[1]]])
      put.push(Math.floor(((axis.value(axis.at(p)) - span[0]) / (span[1] - span[0])) * n));
    const [column, row] = put;
    if (column < 0 || row < 0 || column >= shape[1] || row >= shape[0]) return undefined;
    const value = values[row * shape[1] + column];
    return [[panel.x, at[0], "x"], [panel.y, at[1], "y"]].map(([axis, p, letter]) => {
      const [name, unit] = split(axis.label);
      return `${name ? `${name}: ` : axis.ticks ? "" : `${letter}: `}${axis.say(axis.value(axis.at(p)))}${unit}`;
    }).concat(`${panel.title || "value"}: ${value === null ? "none" : write(value, 3)}`);
  }
  tell(panel, part, point, at) {
    const values = [panel.x, panel.y].map((axis, i) => axis.value((point[i] - axis.from) / (axis.to - axis.from)));
    const near = (part.errors ?? []).find(([x, y]) =>
      Math.hypot(panel.x.place(panel.x.share(x)) - at[0], panel.y.place(panel.y.share(y)) - at[1]) < 1);
    if (near) [values[0], values[1]] = near;
    const said = [panel.x, panel.y].map((axis, i) => {
      const [name, unit] = split(axis.label);
      return `${name || "xy"[i]}: ${axis.say(values[i])}${i && near ? ` ± ${write(near[2], 3)}` : ""}${unit}`;
    });
    this.display(at, [...(part.name ? [part.name] : []), ...said], [{ colour: part.colour, at }]);
  }
  display(at, said, marks, panel) {
    this.over.replaceChildren();
    if (panel) create("line", { class: "cross", x1: at[0], x2: at[0], y1: panel.box[1], y2: panel.box[3] }, this.over);
    const lines = said.map((text) => ({ text }));
    for (const { colour, at: [x, y], text } of marks) {
      create("circle", { class: "at", cx: x, cy: y, r: 4 }, this.over).style.stroke = colour;
      if (text) lines.push({ text, colour });
    }
    this.readout.replaceChildren(...lines.map(({ text, colour }) => {
      const line = document.createElement("div");
      line.textContent = text;
      if (colour) {
        const swatch = document.createElement("i");
        swatch.style.background = colour;
        line.prepend(swatch);
      }
      return line;
    }));
    this.readout.hidden = false;
    // Beside the pointer, and inside the frame.
    const frame = this.frame.getBoundingClientRect(), matrix = this.svg.getScreenCTM();
    const x = matrix.a * at[0] + matrix.e - frame.left, y = matrix.d * at[1] + matrix.f - frame.top;
    const { offsetWidth: wide, offsetHeight: high } = this.readout;
    const left = x + 14 + wide > frame.width ? x - 14 - wide : x + 14;
    this.readout.style.left = `${Math.max(0, Math.min(left, frame.width - wide)) + this.frame.scrollLeft}px`;
    this.readout.style.top = `${Math.max(0, Math.min(y - high - 8, frame.height - high))}px`;
  }
}

for (const figure of document.querySelectorAll("figure")) new Plot(figure);
