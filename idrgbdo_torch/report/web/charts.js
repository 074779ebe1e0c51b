// Lines and dots over time. All charts share one cursor, the frame of the slider; the legend tells the values there.
"use strict";

const MARGIN = { left: 58, right: 12, top: 8, bottom: 24 };
const STATUS = ["#2a9d8f", "#d99a06", "#b91c1c"];

class Chart {
  constructor(element, spec, times, seek) {
    Object.assign(this, { element, spec, times, seek, frame: times.length - 1 });
    this.series = spec.series.map(one => ({ ...one, values: numbers(one.values, Float32Array), on: true }));
    element.innerHTML = `<div class="chart-title"></div><div class="legend"></div><div class="plot"><canvas></canvas><i></i></div>`;
    element.querySelector(".chart-title").textContent = spec.title;
    this.canvas = element.querySelector("canvas");
    this.canvas.style.height = spec.height + "px";
    this.cursor = element.querySelector("i");
    this.legend = element.querySelector(".legend");
    for (const one of this.series) {
      const button = document.createElement("button");
      button.innerHTML = `<s style="background:${one.color}"></s><span></span><b></b>`;
      button.querySelector("span").textContent = one.name;
      button.addEventListener("click", () => { one.on = !one.on; button.classList.toggle("off", !one.on); this.paint(); });
      one.value = button.querySelector("b");
      this.legend.append(button);
    }
    onDrag(this.canvas, x => seek(frameAt(times, this.time(x))));
    new ResizeObserver(() => this.paint()).observe(this.canvas);
  }

  time(x) { return (x - MARGIN.left) / (this.box.width - MARGIN.left - MARGIN.right) * this.span; }
  x(time) { return MARGIN.left + (time / this.span) * (this.box.width - MARGIN.left - MARGIN.right); }

  show(frame) {
    this.frame = frame;
    for (const one of this.series) {
      const value = one.values[frame];
      one.value.textContent = Number.isNaN(value) ? "–" : value.toFixed(Math.abs(value) < 10 ? 2 : 1);
    }
    if (this.box) this.cursor.style.left = this.x(this.times[frame]) + "px";
  }

  paint() {
    this.box = this.canvas.getBoundingClientRect();
    const { width, height } = this.box, ratio = window.devicePixelRatio || 1, c = this.canvas.getContext("2d");
    if (!width) return;
    this.canvas.width = width * ratio; this.canvas.height = height * ratio;
    c.scale(ratio, ratio);
    this.span = Math.max(this.times[this.times.length - 1], 1e-6);
    const log = this.spec.log, on = this.series.filter(one => one.on);
    let low = Infinity, high = -Infinity;
    for (const one of on) for (const value of one.values)
      if (!Number.isNaN(value) && (!log || value > 0)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (low > high) [low, high] = [log ? 0.1 : 0, 1];
    if (this.spec.zero) low = Math.min(0, low);
    if (log) [low, high] = [Math.log10(low) - 0.05, Math.log10(high) + 0.05];
    const room = 0.05 * (high - low) || 0.5;
    if (!this.spec.zero) low -= room;
    high += room;
    const bottom = height - MARGIN.bottom, y = value => bottom - ((log ? Math.log10(value) : value) - low) / (high - low) * (bottom - MARGIN.top);
    c.font = "12px system-ui, sans-serif"; c.fillStyle = "#66727f"; c.strokeStyle = "#e6eaee"; c.lineWidth = 1;
    c.textAlign = "right"; c.textBaseline = "middle";
    for (const tick of log ? decades(low, high) : steps(low, high, 5)) {
      c.beginPath(); c.moveTo(MARGIN.left, y(tick)); c.lineTo(width - MARGIN.right, y(tick)); c.stroke();
      c.fillText(short(tick), MARGIN.left - 6, y(tick));
    }
    c.save(); c.translate(12, (MARGIN.top + bottom) / 2); c.rotate(-Math.PI / 2); c.textAlign = "center"; c.fillText(this.spec.unit, 0, 0); c.restore();
    c.textAlign = "center"; c.textBaseline = "top";
    for (const tick of steps(0, this.span, Math.max(2, Math.floor(width / 110)))) c.fillText(short(tick) + " s", this.x(tick), bottom + 6);
    c.strokeStyle = "#c3cad2"; c.setLineDash([1, 3]);
    for (const frame of this.spec.marks || []) { c.beginPath(); c.moveTo(this.x(this.times[frame]), MARGIN.top); c.lineTo(this.x(this.times[frame]), bottom); c.stroke(); }
    c.setLineDash([]);
    for (const one of on) this.paintSeries(c, one, y, log);
    this.show(this.frame);
  }

  paintSeries(c, one, y, log) {
    c.strokeStyle = c.fillStyle = one.color; c.lineWidth = 1.5; c.lineJoin = "round";
    let before = false;
    c.beginPath();
    one.values.forEach((value, k) => {
      const there = !Number.isNaN(value) && (!log || value > 0);
      if (there && one.dots) c.rect(this.x(this.times[k]) - 1.2, y(value) - 1.2, 2.4, 2.4);
      else if (there && before) c.lineTo(this.x(this.times[k]), y(value));
      else if (there) c.moveTo(this.x(this.times[k]), y(value));
      before = there;
    });
    if (one.dots) c.fill(); else c.stroke();
  }
}

class Strip { // statuses over time, keyframes as ticks above
  constructor(canvas, times, status, keyframes, seek) {
    Object.assign(this, { canvas, times, status, keyframes, frame: times.length - 1 });
    onDrag(canvas, x => seek(Math.round(x / canvas.getBoundingClientRect().width * Math.max(1, times.length - 1))));
    new ResizeObserver(() => this.paint()).observe(canvas);
  }

  show(frame) { this.frame = frame; this.paint(); }

  paint() {
    const { width, height } = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const c = this.canvas.getContext("2d"), last = Math.max(1, this.times.length - 1), x = frame => frame / last * width;
    this.canvas.width = width * ratio; this.canvas.height = height * ratio;
    c.scale(ratio, ratio);
    for (let level = 0; level < 3; level++) { // the worst is drawn last, and never narrower than can be seen
      c.fillStyle = STATUS[level];
      for (let begin = 0; begin < this.status.length; begin++) {
        if (this.status[begin] !== level) continue;
        let end = begin;
        while (end + 1 < this.status.length && this.status[end + 1] === level) end++;
        c.fillRect(x(begin - 0.5), 8, Math.max(level ? 2 : 0, x(end + 0.5) - x(begin - 0.5)), height - 8);
        begin = end;
      }
    }
    c.fillStyle = "#66727f";
    for (const frame of this.keyframes) c.fillRect(x(frame) - 0.5, 0, 1, 6);
    c.fillStyle = "#1d2733";
    c.fillRect(Math.min(width - 2, Math.max(0, x(this.frame) - 1)), 0, 2, height);
  }
}

function onDrag(canvas, act) {
  const tell = event => act(event.clientX - canvas.getBoundingClientRect().left);
  canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); tell(event); });
  canvas.addEventListener("pointermove", event => { if (event.buttons) tell(event); });
}

function frameAt(times, time) { // the nearest
  let low = 0, high = times.length - 1;
  while (low < high) { const mid = (low + high) >> 1; if (times[mid] < time) low = mid + 1; else high = mid; }
  return low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
}

function steps(low, high, count) {
  const step = roundStep((high - low) / count || 1), ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9; k++) ticks.push(k * step);
  return ticks;
}

function decades(low, high) { // of logarithms
  for (const parts of [[1, 2, 5], [1, 3], [1]]) {
    const ticks = [];
    for (let e = Math.floor(low); e <= Math.ceil(high); e++) for (const m of parts) {
      const log = Math.log10(m * 10 ** e);
      if (log >= low && log <= high) ticks.push(m * 10 ** e);
    }
    if (ticks.length <= 8 || parts.length === 1) return ticks;
  }
}

const short = value => String(parseFloat(value.toPrecision(6)));
