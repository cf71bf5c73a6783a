// The axes of a figure's panels, and numbers as a person reads them.
const write = (value, digits = 6) => {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e7 || size < 1e-4)) return value.toExponential(digits - 2);
  return String(Number(value.toPrecision(digits)));
};
const split = (label) => {
  const found = /^(.*?)\s*\[([^\]]*)\]\s*$/.exec(label);
  return found ? [found[1], ` ${found[2]}`] : [label, ""];
};

/** One axis: from values to places in the drawing and back, and the part of it that is shown. */
class Axis {
  constructor(told, from, to) {
    Object.assign(this, told, { from, to, shown: [0, 1] });
    [this.low, this.high] = told.limits.map((x) => this.straighten(x));
  }
  straighten(value) {
    if (this.scale === "log") return Math.log10(value);
    if (this.scale !== "symlog") return value;
    const linear = this.linear / (1 - 1 / this.base), size = Math.abs(value) / this.threshold;
    if (size <= 1) return value * linear;
    return Math.sign(value) * this.threshold * (linear + Math.log(size) / Math.log(this.base));
  }
  bend(x) {
    if (this.scale === "log") return 10 ** x;
    if (this.scale !== "symlog") return x;
    const linear = this.linear / (1 - 1 / this.base);
    if (Math.abs(x) <= this.threshold * linear) return x / linear;
    return Math.sign(x) * this.threshold * this.base ** (Math.abs(x) / this.threshold - linear);
  }
  share(value) { return (this.straighten(value) - this.low) / (this.high - this.low); }
  value(share) { return this.bend(this.low + share * (this.high - this.low)); }
  // [a, b]: what was drawn at p is shown at a p + b.
  get map() {
    const [first, last] = this.shown, a = 1 / (last - first);
    return [a, this.from - a * (this.from + first * (this.to - this.from))];
  }
  at(p) { return this.shown[0] + ((p - this.from) / (this.to - this.from)) * (this.shown[1] - this.shown[0]); }
  place(share) { return this.from + ((share - this.shown[0]) / (this.shown[1] - this.shown[0])) * (this.to - this.from); }
  zoom(first, last) {
    let [a, b] = first < last ? [first, last] : [last, first];
    const span = Math.min(1, Math.max(b - a, 1e-6));
    a = Math.min(Math.max((a + b - span) / 2, 0), 1 - span);
    this.shown = [a, a + span];
  }
  get zoomed() { return this.shown[1] - this.shown[0] < 1 - 1e-9; }
  say(value) {
    const named = this.ticks?.find(([at]) => Math.abs(at - value) < 0.5);
    if (named && this.scale !== "symlog") return named[1];
    if (this.scale === "date") return new Date(864e5 * value).toISOString().slice(0, 10);
    return write(value);
  }
  get steps() {
    const [a, b] = this.shown.map((x) => this.value(x)), low = Math.min(a, b), high = Math.max(a, b);
    if (this.ticks) return this.ticks.filter(([at]) => at >= low && at <= high);
    if (this.scale === "log" && high / low > 8) {
      const found = [], some = high / low > 1e3 ? [1] : [1, 2, 5];
      for (let n = Math.floor(Math.log10(low)); n <= Math.log10(high); n++)
        for (const k of some) found.push(k * 10 ** n);
      const every = Math.ceil(found.length / 9);
      return found.filter((x, i) => x >= low && x <= high && i % every === 0).map((x) => [x, write(x, 3)]);
    }
    const rough = (high - low) / 5, ten = 10 ** Math.floor(Math.log10(rough));
    let step = [1, 2, 2.5, 5, 10].find((k) => k * ten >= rough) * ten;
    if (this.scale === "date") step = Math.max(1, Math.round(step));
    const places = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9) + (/^2\.?5/.test(String(step / ten)) ? 1 : 0)));
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
      const at = k * step, size = Math.max(Math.abs(low), Math.abs(high));
      const text = this.scale === "date" ? this.say(at) : size >= 1e6 || (size < 1e-3 && size > 0)
        ? write(at, 2 + Math.max(2, Math.ceil(Math.log10(size / step)))) : at.toFixed(places);
      found.push([at, text.replace(/^-(0(\.0+)?)$/, "$1")]);
    }
    return found;
  }
}
