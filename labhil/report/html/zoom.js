// Plots of a page: drag across one to look closer, double-click for the whole, point to read values.
// Data are moved under the frame that the drawing has; ticks are written anew from what the frame shows.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const LEAST_DRAG = 4, LEAST_HEIGHT = 14, CLOSEST = 1e-4, TICKS = { x: 7, y: 5 };

  const made = (name, attributes, parent) => {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    parent.append(element);
    return element;
  };

  // Straight between the entries of a table; outside as at its ends.
  const between = (from, to, place) => {
    let k = from.findIndex((each) => each >= place);
    if (k < 0) k = from.length - 1;
    k = Math.max(k, 1);
    const share = (place - from[k - 1]) / (from[k] - from[k - 1] || 1);
    return to[k - 1] + share * (to[k] - to[k - 1]);
  };

  const nice = (low, high, count) => {
    const rough = (high - low) / count, unit = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((each) => each * unit).find((each) => each >= rough);
    const ticks = [];
    for (let k = Math.ceil(low / step); k * step <= high && ticks.length < 20; k++) ticks.push(k * step);
    const digits = Math.max(0, Math.min(12, -Math.floor(Math.log10(step) + 1e-9)));
    const large = Math.max(Math.abs(low), Math.abs(high));
    const plain = large < 1e6 && step >= 1e-4;
    return ticks.map((tick) => [tick, (plain ? tick.toFixed(digits) : tick.toExponential(2)).replace("-", "−")]);
  };

  class Axis {
    constructor(scale, start, length) {
      Object.assign(this, scale, { start, length, first: start, last: start + length });
    }
    get scale() { return this.length / (this.last - this.first); }
    shown(place) { return this.start + (place - this.first) * this.scale; }
    drawn(shown) { return this.first + (shown - this.start) / this.scale; }
    value(place) { return between(this.at, this.values, place); }
    place(value) {
      const up = this.values[0] <= this.values[this.values.length - 1];
      const [values, at] = up ? [this.values, this.at] : [[...this.values].reverse(), [...this.at].reverse()];
      return between(values, at, value);
    }
    look(first, last) {
      const least = this.length * CLOSEST, middle = 0.5 * (first + last);
      const half = 0.5 * Math.min(Math.max(last - first, least), this.length);
      const begin = Math.min(Math.max(middle - half, this.start), this.start + this.length - 2 * half);
      [this.first, this.last] = [begin, begin + 2 * half];
    }
    whole() { [this.first, this.last] = [this.start, this.start + this.length]; }
    get isWhole() { return this.last - this.first > this.length * (1 - 1e-9); }
    // Whether both say the same quantity: by their label, or as one stands above the other.
    like(other) {
      const above = Math.abs(this.start - other.start) < 1 && Math.abs(this.length - other.length) < 1;
      const same = this.values[0] === other.values[0] && this.values.at(-1) === other.values.at(-1);
      return (this.label !== "" && this.label === other.label) || (above && same);
    }
    lookAt(values) {
      this.look(...values.map((value) => this.place(value)).sort((a, b) => a - b));
    }
  }

  class Plot {
    constructor(svg, frame) {
      this.svg = svg;
      this.group = document.getElementById(frame.id);
      this.x = new Axis(frame.x, frame.left, frame.width);
      this.y = new Axis(frame.y, frame.top, frame.height);
      this.parts = [...this.group.querySelectorAll("[clip-path]")]
        .filter((part) => !part.closest('[id*="matplotlib.axis"]')).map((part) => this.framed(part));
      this.ticks = made("g", { class: "own-ticks" }, this.group);
      this.band = made("rect", { class: "band", visibility: "hidden" }, this.group);
      this.line = made("line", { class: "pointer", visibility: "hidden" }, this.group);
      this.read = made("text", { class: "read", visibility: "hidden" }, this.group);
    }
    framed(part) {
      const frame = made("g", { "clip-path": part.getAttribute("clip-path") }, part.parentNode);
      part.replaceWith(frame);
      part.removeAttribute("clip-path");
      const moved = made("g", {}, frame);
      moved.append(part);
      for (const path of moved.querySelectorAll("path")) path.style.vectorEffect = "non-scaling-stroke";
      const dots = [...moved.querySelectorAll("use")].map((use) => [use, +use.getAttribute("x"), +use.getAttribute("y")]);
      return { moved, dots };
    }
    holds(x, y) {
      return x >= this.x.start && x <= this.x.start + this.x.length && y >= this.y.start && y <= this.y.start + this.y.length;
    }
    draw() {
      const { x, y } = this, [dx, dy] = [x.shown(0), y.shown(0)];
      for (const { moved, dots } of this.parts) {
        if (!dots.length) moved.setAttribute("transform", `matrix(${x.scale} 0 0 ${y.scale} ${dx} ${dy})`);
        for (const [use, u, v] of dots) {
          use.setAttribute("x", x.shown(u));
          use.setAttribute("y", y.shown(v));
        }
      }
      this.ticks.replaceChildren();
      for (const [name, axis, k] of [["x", x, 1], ["y", y, 2]]) this.label(name, axis, k);
    }
    label(name, axis, number) {
      const drawn = this.group.querySelectorAll('[id*="matplotlib.axis_"]')[number - 1];
      for (const tick of drawn ? drawn.querySelectorAll(`[id*="${name}tick_"]`) : []) {
        tick.style.display = axis.isWhole ? "" : "none";
      }
      // a plot over another one has no labels of its own
      if (axis.isWhole || !drawn || !drawn.querySelector(`[id*="${name}tick_"] text`)) return;
      const ends = [axis.value(axis.first), axis.value(axis.last)].sort((a, b) => a - b);
      for (const [value, text] of nice(...ends, TICKS[name])) {
        const place = axis.shown(axis.place(value));
        if (!(place >= axis.start - 0.5 && place <= axis.start + axis.length + 0.5)) continue;
        const bottom = this.y.start + this.y.length, left = this.x.start;
        const [line, at] = name === "x"
          ? [{ x1: place, x2: place, y1: bottom, y2: bottom + 3.5 }, { x: place, y: bottom + 14, "text-anchor": "middle" }]
          : [{ x1: left - 3.5, x2: left, y1: place, y2: place }, { x: left - 6, y: place + 3.5, "text-anchor": "end" }];
        made("line", line, this.ticks);
        made("text", at, this.ticks).textContent = text;
      }
    }
    point(x, y) {
      const [u, v] = [this.x.value(this.x.drawn(x)), this.y.value(this.y.drawn(y))];
      const rounded = (value) => Number(value.toPrecision(4)).toString().replace("-", "−");
      for (const [key, value] of Object.entries({ x1: x, x2: x, y1: this.y.start, y2: this.y.start + this.y.length })) {
        this.line.setAttribute(key, value);
      }
      const right = x > this.x.start + 0.5 * this.x.length, low = y > this.y.start + 20;
      const place = { x: x + (right ? -5 : 5), y: y + (low ? -6 : 14), "text-anchor": right ? "end" : "start" };
      for (const [key, value] of Object.entries(place)) this.read.setAttribute(key, value);
      this.read.textContent = `x ${rounded(u)}, y ${rounded(v)}`;
      this.line.setAttribute("visibility", "visible");
      this.read.setAttribute("visibility", "visible");
    }
    leave() {
      for (const part of [this.line, this.read, this.band]) part.setAttribute("visibility", "hidden");
    }
    select(from, to) {
      const [x0, x1] = [from.x, to.x].sort((a, b) => a - b);
      const [y0, y1] = tall(from, to) ? [from.y, to.y].sort((a, b) => a - b) : [this.y.start, this.y.start + this.y.length];
      const box = { x: x0, y: y0, width: x1 - x0, height: y1 - y0, visibility: "visible" };
      for (const [key, value] of Object.entries(box)) this.band.setAttribute(key, value);
    }
  }

  const tall = (from, to) => Math.abs(to.y - from.y) > LEAST_HEIGHT;

  const set_up = (svg) => {
    const plots = JSON.parse(svg.dataset.axes).map((frame) => new Plot(svg, frame));
    const at = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const under = (place) => plots.find((plot) => plot.holds(place.x, place.y));
    const together = (plot, first, last) => {
      plot.x.look(first, last);
      const values = [plot.x.value(plot.x.first), plot.x.value(plot.x.last)];
      for (const each of plots) if (each !== plot && each.x.like(plot.x)) each.x.lookAt(values);
      for (const each of plots) each.draw();
    };
    let drag = null, chosen = plots[0];
    svg.addEventListener("pointerdown", (event) => {
      const place = at(event), plot = under(place);
      if (event.button !== 0 || !plot) return;
      event.preventDefault();
      svg.setPointerCapture(event.pointerId);
      svg.focus({ preventScroll: true });
      [drag, chosen] = [{ plot, place }, plot];
    });
    svg.addEventListener("pointermove", (event) => {
      const place = at(event), plot = under(place);
      for (const each of plots) if (each !== plot) each.leave();
      if (plot) plot.point(place.x, place.y);
      if (drag) drag.plot.select(drag.place, clamped(drag.plot, place));
    });
    svg.addEventListener("pointerup", (event) => {
      if (!drag) return;
      const { plot, place: from } = drag, to = clamped(plot, at(event));
      drag = null;
      plot.leave();
      if (Math.abs(to.x - from.x) < LEAST_DRAG) return;
      if (tall(from, to)) plot.y.look(...[from.y, to.y].map((y) => plot.y.drawn(y)).sort((a, b) => a - b));
      const ends = [from.x, to.x].map((x) => plot.x.drawn(x)).sort((a, b) => a - b);
      together(plot, ...ends);
    });
    svg.addEventListener("pointercancel", () => { drag = null; plots.forEach((plot) => plot.leave()); });
    svg.addEventListener("pointerleave", () => plots.forEach((plot) => plot.leave()));
    const whole = () => {
      for (const plot of plots) [plot.x, plot.y].forEach((axis) => axis.whole());
      for (const plot of plots) plot.draw();
    };
    svg.addEventListener("dblclick", (event) => { event.preventDefault(); whole(); });
    svg.addEventListener("keydown", (event) => {
      const { first, last } = chosen.x, width = last - first;
      const moves = { ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2], "+": [0.2, -0.2], "-": [-1 / 3, 1 / 3] }[event.key];
      if (event.key === "0") whole();
      else if (moves) together(chosen, first + moves[0] * width, last + moves[1] * width);
      else return;
      event.preventDefault();
    });
    svg.setAttribute("tabindex", "0");
    svg.classList.add("live");
  };

  const clamped = (plot, place) => ({
    x: Math.min(Math.max(place.x, plot.x.start), plot.x.start + plot.x.length),
    y: Math.min(Math.max(place.y, plot.y.start), plot.y.start + plot.y.length),
  });

  const drawings = document.querySelectorAll("svg[data-axes]");
  drawings.forEach(set_up);
  if (drawings.length) {
    const hint = document.createElement("p");
    hint.className = "hint";
    hint.textContent = "Drag across a plot to look closer, double-click for the whole; keys: + − ← → 0.";
    document.querySelector("main").prepend(hint);
  }
})();
