// What a figure's panels hold: lines, marks, areas and texts that move with the values.
const create = (tag, attributes, parent) => {
  const made = document.createElementNS(document.querySelector("svg").namespaceURI, tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
};

/** A part of a panel that moves with the values: a line, marks, an area, a text. */
class Part {
  constructor(told, svg) {
    Object.assign(this, told);
    this.group = svg.getElementById(told.id);
    if (!this.group) return;
    const clipped = this.group.querySelector("[clip-path]") ?? (this.group.hasAttribute("clip-path") ? this.group : null);
    const clip = clipped?.getAttribute("clip-path");
    for (const one of this.group.querySelectorAll("[clip-path]")) one.removeAttribute("clip-path");
    this.marks = told.line ? [...this.group.querySelectorAll("use")].map((mark) => ({
      mark, x: Number(mark.getAttribute("x")), y: Number(mark.getAttribute("y")),
    })) : [];
    const scaled = [...this.group.children].filter((one) => one.tagName !== "defs" && !one.querySelector("use"));
    if (!told.line) scaled.splice(0, scaled.length, ...[...this.group.children].filter((one) => one.tagName !== "defs"));
    this.inner = create("g", { class: "drawn" }, this.group);
    this.inner.append(...scaled.filter((one) => one.tagName !== "use" || !told.line));
    if (clip) this.group.setAttribute("clip-path", clip);
    this.paths = told.line ? [...this.inner.querySelectorAll("path")] : [];
  }
  get colour() {
    const drawn = this.group?.querySelector("path[style*=stroke], use");
    const style = drawn && getComputedStyle(drawn);
    return !style ? "currentColor" : style.stroke !== "none" ? style.stroke : style.fill;
  }
  show(panel) {
    if (!this.group) return;
    const [a, b] = this.x ? panel.x.map : [1, 0], [c, d] = this.y ? panel.y.map : [1, 0];
    if (this.at) { // a text keeps its size
      const [x, y] = this.at, dx = a * x + b - x, dy = c * y + d - y;
      this.group.setAttribute("transform", `translate(${dx} ${dy})`);
      const out = (this.x && !panel.inside(x + dx, panel.box[1])) || (this.y && !panel.inside(panel.box[0], y + dy));
      this.group.style.display = out && (panel.x.zoomed || panel.y.zoomed) ? "none" : "";
      return;
    }
    this.inner.setAttribute("transform", `matrix(${a} 0 0 ${c} ${b} ${d})`);
    for (const { mark, x, y } of this.marks) {
      mark.setAttribute("x", a * x + b);
      mark.setAttribute("y", c * y + d);
    }
  }
  // The points, as they were drawn at first: of marks, of dots, else the corners of the line.
  get points() {
    if (this.known) return this.known;
    if (this.marks?.length) return (this.known = this.marks.map(({ x, y }) => [x, y]));
    const some = (this.paths ?? []).flatMap((path) =>
      [...(path.getAttribute("d") ?? "").matchAll(/([ML])\s*(-?[\d.]+)[ ,](-?[\d.]+)/g)].map((m) => [+m[2], +m[3], m[1] === "M"]));
    return (this.known = some);
  }
  get isMarks() { return Boolean(this.marks?.length) || Boolean(this.paths?.some((path) => path.classList.contains("dots"))); }
  // Where the line is at x, as drawn at first.
  cross(x) {
    const p = this.points;
    for (let i = 1; i < p.length; i++) {
      if (p[i][2] || (p[i - 1][0] - x) * (p[i][0] - x) > 0 || p[i - 1][0] === p[i][0]) continue;
      return p[i - 1][1] + ((x - p[i - 1][0]) / (p[i][0] - p[i - 1][0])) * (p[i][1] - p[i - 1][1]);
    }
    return undefined;
  }
}

class Panel {
  constructor(told, svg) {
    Object.assign(this, told);
    const [left, top, right, bottom] = told.box;
    this.x = new Axis(told.x, left, right);
    this.y = new Axis(told.y, bottom, top);
    this.svg = svg;
    this.root = svg.getElementById(told.id);
    this.parts = told.parts.map((part) => new Part(part, svg)).filter((part) => part.group);
    for (const image of this.root.querySelectorAll(":scope > image, :scope > g > image")) {
      const group = create("g", {}, null), inner = create("g", { class: "drawn" }, group);
      const clip = image.parentNode === this.root ? null : image.parentNode.getAttribute("clip-path");
      const old = clip ? image.parentNode : image;
      old.replaceWith(group);
      if (clip) group.setAttribute("clip-path", clip);
      inner.append(image);
      this.parts.push({ group, inner, x: true, y: true, marks: [], points: [], show: Part.prototype.show });
    }
    this.ticks = create("g", { class: "ticks" });
    this.root.prepend(this.ticks);
  }
  inside(x, y) {
    const [left, top, right, bottom] = this.box;
    return x >= left - 0.5 && x <= right + 0.5 && y >= top - 0.5 && y <= bottom + 0.5;
  }
  show() {
    for (const part of this.parts) part.show(this);
    this.ticks.replaceChildren();
    for (const letter of ["x", "y"]) {
      const axis = this[letter], group = this.svg.getElementById(`${this.id}.${letter}`);
      for (const one of group?.children ?? [])
        if (/tick_/.test(one.id) || /offset$/.test(one.id)) one.style.display = axis.zoomed ? "none" : "";
      if (axis.zoomed) this.drawTicks(letter, axis);
    }
  }
  drawTicks(letter, axis) {
    const [left, top, right, bottom] = this.box;
    for (const [value, text] of axis.steps) {
      const p = axis.place(axis.share(value));
      const line = letter === "x" ? { x1: p, x2: p, y1: axis.grid ? top : bottom, y2: bottom + 3.5 }
        : { x1: left - 3.5, x2: axis.grid ? right : left, y1: p, y2: p };
      create("line", line, this.ticks);
      if (!axis.labelled) continue;
      const place = letter === "x" ? { x: p, y: bottom + 14.5, "text-anchor": "middle" }
        : { x: left - 7, y: p + 3.5, "text-anchor": "end" };
      create("text", place, this.ticks).textContent = text;
    }
  }
}
