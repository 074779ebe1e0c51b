// One slider moves everything: the scene, the image with its points, the statuses, the cursors of the charts.
"use strict";

function numbers(text, kind) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = letters.charCodeAt(k);
  return new kind(bytes.buffer);
}

const DATA = JSON.parse(document.getElementById("data").textContent);
const TIMES = numbers(DATA.times, Float32Array), STATUSES = numbers(DATA.status, Uint8Array);
const KEYFRAMES = numbers(DATA.keyframes, Uint32Array), MS = numbers(DATA.ms, Float32Array);
const NAMES = ["ok", "weak", "lost"];
const one = selector => document.querySelector(selector);

class Glimpses { // what is kept of single frames
  constructor(data) {
    this.data = data;
    this.frame = [...numbers(data.frame, Uint32Array)];
    this.points = numbers(data.points, Uint16Array);
    this.begin = [0];
    for (const count of numbers(data.count, Uint32Array)) this.begin.push(this.begin[this.begin.length - 1] + count);
    this.place = new Map(this.frame.map((frame, k) => [frame, k]));
    this.withImage = Object.keys(data.images).map(Number).sort((a, b) => a - b);
    const worths = this.points.filter((_, k) => k % 4 === 3).sort(); // the few that are worth most would leave all dark
    this.most = Math.max(1e-3, (worths[Math.floor(0.98 * worths.length)] || 0) / data.steps[2]);
    this.loaded = new Map();
  }

  pointsOf(frame) {
    const k = this.place.get(frame), [px, mm, bits] = this.data.steps, out = [];
    if (k === undefined) return out;
    for (let i = 4 * this.begin[k]; i < 4 * this.begin[k + 1]; i += 4) {
      const worth = this.points[i + 3] / bits;
      out.push({ u: this.points[i] / px, v: this.points[i + 1] / px, depth: this.points[i + 2] / mm, bits: worth, share: Math.min(1, worth / this.most) });
    }
    return out.sort((a, b) => a.bits - b.bits); // the best on top
  }

  windowOf(frame) { const k = lastAtMost(this.frame, frame); return k < 0 ? [] : this.data.windows[k]; }
  imageFrame(frame) { const k = lastAtMost(this.withImage, frame); return k < 0 ? null : this.withImage[k]; }
  image(frame, then) {
    let image = this.loaded.get(frame);
    if (!image) {
      image = new Image();
      image.src = "data:image/jpeg;base64," + this.data.images[frame];
      this.loaded.set(frame, image);
    }
    if (image.complete && image.naturalWidth) then(image);
    else image.addEventListener("load", () => then(image), { once: true });
  }
}

class Player {
  constructor() {
    this.frame = TIMES.length - 1;
    this.charts = [];
    this.glimpses = new Glimpses(DATA.scene.glimpses);
    this.scene = new Scene(one("#space"), DATA.scene, TIMES.length);
    this.scene.pointsOf = frame => this.glimpses.pointsOf(frame);
    this.scene.windowOf = frame => this.glimpses.windowOf(frame);
    this.strip = new Strip(one("#strip"), TIMES, STATUSES, KEYFRAMES, frame => this.seek(frame));
    this.slider = one("#slider");
    this.slider.max = TIMES.length - 1;
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    for (const element of document.querySelectorAll("[data-chart]"))
      this.charts.push(new Chart(element, DATA.charts[Number(element.dataset.chart)], TIMES, frame => this.seek(frame)));
    this.buttons();
    if (!this.glimpses.withImage.length) one("#scene").classList.add("no-image");
    one("#grid").textContent = `a square of the grid is ${this.scene.square} m`;
    new ResizeObserver(() => this.paintImage()).observe(one("#seen"));
    this.seek(this.frame);
  }

  buttons() {
    const act = { all: () => this.scene.reset(), above: () => this.scene.above(), behind: () => this.scene.follow() };
    for (const [name, what] of Object.entries(act)) one(`#view-${name}`).addEventListener("click", what);
    one("#play").addEventListener("click", () => this.timer ? this.stop() : this.play());
    const doubt = one("#doubt");
    doubt.hidden = !STATUSES.some(level => level > 0);
    doubt.addEventListener("click", () => this.seek(this.nextDoubt()));
    for (const button of document.querySelectorAll("[data-layer]")) button.addEventListener("click", () => {
      const name = button.dataset.layer;
      this.scene.shown[name] = this.scene.shown[name] === false;
      button.classList.toggle("off", !this.scene.shown[name]);
      this.scene.draw();
    });
  }

  nextDoubt() { // the begin of the next stretch, round the end
    for (let k = 1; k <= STATUSES.length; k++) {
      const frame = (this.frame + k) % STATUSES.length;
      if (STATUSES[frame] && (frame === 0 || STATUSES[frame] !== STATUSES[frame - 1])) return frame;
    }
    return this.frame;
  }

  play() {
    if (this.frame === TIMES.length - 1) this.seek(0);
    const begin = performance.now(), from = TIMES[this.frame];
    one("#play").textContent = "❚❚";
    const step = () => {
      const frame = lastAtMost(TIMES, from + (performance.now() - begin) / 1000);
      if (frame !== this.frame) this.show(Math.max(0, frame));
      if (frame >= TIMES.length - 1) this.stop();
    };
    this.timer = setInterval(step, 25);
  }

  stop() { clearInterval(this.timer); this.timer = 0; one("#play").textContent = "▶"; }
  seek(frame) { this.stop(); this.show(Math.max(0, Math.min(TIMES.length - 1, frame))); }

  show(frame) {
    this.frame = frame;
    this.slider.value = frame;
    this.scene.show(frame);
    this.strip.show(frame);
    for (const chart of this.charts) chart.show(frame);
    const level = STATUSES[frame], points = this.glimpses.pointsOf(frame).length;
    const parts = [`frame ${frame} of ${TIMES.length}`, `${TIMES[frame].toFixed(2)} s`];
    if (KEYFRAMES.includes(frame)) parts.push("keyframe");
    if (points) parts.push(`${points} points`);
    if (!Number.isNaN(MS[frame])) parts.push(`${MS[frame].toFixed(1)} ms`);
    one("#state").textContent = NAMES[level];
    one("#state").style.background = STATUS[level];
    one("#about").textContent = parts.join(" · ");
    one("#reason").textContent = DATA.reasons[frame] || "";
    this.paintImage();
  }

  paintImage() {
    const canvas = one("#seen"), frame = this.glimpses.imageFrame(this.frame), wanted = this.frame;
    if (frame === null) return;
    this.glimpses.image(frame, image => {
      const ratio = window.devicePixelRatio || 1, width = canvas.getBoundingClientRect().width * ratio;
      if (wanted !== this.frame || !width) return;
      const [, , , , fullWidth, fullHeight] = DATA.scene.camera || [1, 1, 0, 0, image.naturalWidth, image.naturalHeight];
      const scale = width / fullWidth, c = canvas.getContext("2d");
      canvas.width = width; canvas.height = Math.round(scale * fullHeight);
      c.drawImage(image, 0, 0, canvas.width, canvas.height);
      c.fillStyle = "#00000030"; c.fillRect(0, 0, canvas.width, canvas.height);
      for (const { u, v, share } of this.glimpses.pointsOf(frame))
        disc(c, (u + 0.5) * scale, (v + 0.5) * scale, 4.5 * ratio, DATA.scene.ramp[Math.round(31 * share)], ratio);
      one("#seen-about").textContent = `frame ${frame}: points by what each adds, 0 to ${this.glimpses.most.toFixed(2)} bits and more`;
    });
  }
}

function lastAtMost(sorted, value) { // place of the last that is not above; -1 where all are
  let low = 0, high = sorted.length;
  while (low < high) { const mid = (low + high) >> 1; if (sorted[mid] <= value) low = mid + 1; else high = mid; }
  return low - 1;
}

window.player = new Player();
