// The map in space with camera paths, keyframes, the window and the points of one frame. Drawn without WebGL: some ten
// thousand points go into a depth buffer of our own in a few milliseconds, on any machine and phone.
"use strict";

const LOOK = { estimate: "#ff8a3d", refined: "#4da3ff", reference: "#e8ecf1", keyframe: "#8fa3b870", window: "#ffc53d" };
const BACKGROUND = 0xff1d1712; // a b g r

class Scene {
  constructor(canvas, data, frames) {
    Object.assign(this, { canvas, data, frames, frame: frames - 1, shown: {}, behind: false, pending: false });
    this.context = canvas.getContext("2d");
    this.poses = numbers(data.poses, Float32Array);
    this.lines = Object.fromEntries(Object.entries(data.lines).map(([name, text]) => [name, numbers(text, Float32Array)]));
    this.keyframes = { frame: numbers(data.keyframes.frame, Uint32Array), poses: numbers(data.keyframes.poses, Float32Array) };
    this.readMap(data.map);
    this.measure();
    this.reset();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  readMap(map) {
    const steps = numbers(map.xyz, Uint16Array), rgb = numbers(map.rgb, Uint8Array);
    this.xyz = new Float32Array(steps.length);
    this.color = new Uint32Array(steps.length / 3);
    for (let k = 0; k < steps.length; k++) this.xyz[k] = map.low[k % 3] + map.step * steps[k];
    for (let k = 0; k < this.color.length; k++) // brightened: what was seen indoors is dark
      this.color[k] = 0xff000000 | (lift(rgb[3 * k + 2]) << 16) | (lift(rgb[3 * k + 1]) << 8) | lift(rgb[3 * k]);
    this.since = numbers(map.frame, Uint32Array);
  }

  measure() { // what has to be in view, from the poses and most of the map
    const axes = [0, 1, 2].map(axis => {
      const values = [];
      for (let k = axis; k < this.xyz.length; k += 3) values.push(this.xyz[k]);
      values.sort((a, b) => a - b);
      let low = values.length ? values[Math.floor(0.05 * values.length)] : Infinity;
      let high = values.length ? values[Math.floor(0.95 * values.length)] : -Infinity;
      for (let f = 0; f < this.frames; f++) {
        low = Math.min(low, this.poses[12 * f + 4 * axis + 3]);
        high = Math.max(high, this.poses[12 * f + 4 * axis + 3]);
      }
      return [low, high];
    });
    this.centre = axes.map(([low, high]) => (low + high) / 2);
    this.size = Math.max(0.05, Math.hypot(...axes.map(([low, high]) => high - low)));
    this.floor = axes[2][0];
    this.square = roundStep(this.size / 8);
    const path = [0, 1, 2].map(axis => {
      let low = Infinity, high = -Infinity;
      for (let f = 0; f < this.frames; f++) {
        low = Math.min(low, this.poses[12 * f + 4 * axis + 3]);
        high = Math.max(high, this.poses[12 * f + 4 * axis + 3]);
      }
      return high - low;
    });
    this.frustum = Math.min(0.035 * this.size, Math.max(0.012 * this.size, 0.07 * Math.hypot(...path)));
  }

  reset() { this.look(0.5, 0.4, 0.85 * this.size, this.centre); }
  above() { this.look(0, Math.PI / 2 - 1e-3, 1.05 * this.size, this.centre); }

  look(yaw, pitch, distance, target) {
    this.behind = false;
    Object.assign(this, { yaw, pitch, distance, target: [...target] });
    this.draw();
  }

  follow() { this.behind = true; this.draw(); }
  show(frame) { this.frame = frame; this.draw(); }
  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.paint(); });
  }

  place() { // the eye and its axes right, up, ahead
    if (this.behind) {
      const p = this.poses.subarray(12 * this.frame, 12 * this.frame + 12), ahead = [p[2], p[6], p[10]];
      this.target = [p[3], p[7], p[11]].map((x, k) => x + 4 * this.frustum * ahead[k]);
      this.yaw = Math.atan2(ahead[0], ahead[1]);
      this.pitch = Math.asin(Math.max(-1, Math.min(1, -ahead[2]))) + 0.2;
      this.distance = 12 * this.frustum;
    }
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    const ahead = [sy * cp, cy * cp, -sp], right = [cy, -sy, 0], up = [sy * sp, cy * sp, cp];
    this.axes = { right, up, ahead, eye: this.target.map((x, k) => x - this.distance * ahead[k]) };
  }

  project(x, y, z) {
    const { right: r, up: u, ahead: a, eye: e } = this.axes;
    const dx = x - e[0], dy = y - e[1], dz = z - e[2];
    const depth = a[0] * dx + a[1] * dy + a[2] * dz;
    return [this.width / 2 + this.focal * (r[0] * dx + r[1] * dy + r[2] * dz) / depth,
      this.height / 2 - this.focal * (u[0] * dx + u[1] * dy + u[2] * dz) / depth, depth];
  }

  paint() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), box = this.canvas.getBoundingClientRect();
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (!width || !height) return;
    if (this.width !== width || this.height !== height) {
      Object.assign(this, { width, height });
      this.canvas.width = width; this.canvas.height = height;
      this.image = this.context.createImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
      this.buffer = new Float32Array(width * height);
    }
    this.ratio = ratio;
    this.focal = 0.95 * Math.min(width, 1.4 * height);
    this.place();
    this.pixels.fill(BACKGROUND);
    if (this.shown.map !== false) this.paintMap();
    this.context.putImageData(this.image, 0, 0);
    this.paintFloor();
    for (const name of ["reference", "refined"])
      if (this.lines[name] && this.shown[name] !== false) this.stroke(this.lines[name], 3, 0, 0, LOOK[name], name === "reference" ? 2.5 : 1.5);
    if (this.shown.estimate !== false) this.stroke(this.poses.subarray(0, 12 * (this.frame + 1)), 12, 3, 4, LOOK.estimate, 1.8);
    this.paintKeyframes();
    const pose = this.poses.subarray(12 * this.frame, 12 * this.frame + 12);
    this.paintFrustum(pose, 2 * this.frustum, LOOK.estimate, 2.4);
    if (this.shown.points !== false) this.paintPoints(pose);
  }

  paintMap() {
    const { right: r, up: u, ahead: a, eye: e } = this.axes, { width, height, focal, xyz, pixels, buffer } = this;
    const cx = width / 2, cy = height / 2, side = 0.0045 * this.size * focal;
    buffer.fill(Infinity);
    for (let k = 0, j = 0; k < this.color.length && this.since[k] <= this.frame; k++, j += 3) {
      const dx = xyz[j] - e[0], dy = xyz[j + 1] - e[1], dz = xyz[j + 2] - e[2];
      const depth = a[0] * dx + a[1] * dy + a[2] * dz;
      if (depth < 0.02) continue;
      const s = Math.max(1, Math.min(4 * this.ratio, Math.round(side / depth)));
      const left = Math.round(cx + focal * (r[0] * dx + r[1] * dy + r[2] * dz) / depth - s / 2);
      const top = Math.round(cy - focal * (u[0] * dx + u[1] * dy + u[2] * dz) / depth - s / 2);
      if (left < 0 || top < 0 || left + s > width || top + s > height) continue;
      for (let v = top; v < top + s; v++)
        for (let i = v * width + left, end = i + s; i < end; i++)
          if (depth < buffer[i]) { buffer[i] = depth; pixels[i] = this.color[k]; }
    }
  }

  paintFloor() {
    const step = this.square, c = this.centre, reach = Math.ceil(this.size / 2 / step) * step;
    const begin = c.map(x => Math.round(x / step) * step);
    for (let d = -reach; d <= reach + 1e-9; d += step) {
      this.segment([begin[0] - reach, begin[1] + d, this.floor], [begin[0] + reach, begin[1] + d, this.floor], "#ffffff1c", 1);
      this.segment([begin[0] + d, begin[1] - reach, this.floor], [begin[0] + d, begin[1] + reach, this.floor], "#ffffff1c", 1);
    }
  }

  stroke(values, stride, first, step, color, size) { // a path; coordinates lie `step` apart (1 where it is 0)
    const c = this.context, gap = step || 1;
    c.beginPath();
    let before = false;
    for (let k = first; k < values.length; k += stride) {
      const [x, y, depth] = this.project(values[k], values[k + gap], values[k + 2 * gap]);
      if (depth < 0.02) { before = false; continue; }
      if (before) c.lineTo(x, y); else c.moveTo(x, y);
      before = true;
    }
    this.ink(color, size);
  }

  segment(from, to, color, size) {
    const [x, y, z] = this.project(...from), [u, v, w] = this.project(...to), c = this.context;
    if (z < 0.02 || w < 0.02) return;
    c.beginPath(); c.moveTo(x, y); c.lineTo(u, v);
    this.ink(color, size);
  }

  ink(color, size) {
    const c = this.context;
    c.strokeStyle = color; c.lineWidth = size * this.ratio; c.lineJoin = "round";
    c.stroke();
  }

  paintKeyframes() {
    if (this.shown.keyframes === false) return;
    const inside = new Set(this.windowOf ? this.windowOf(this.frame) : []), centres = [];
    this.keyframes.frame.forEach((frame, k) => {
      if (frame > this.frame) return;
      const pose = this.keyframes.poses.subarray(12 * k, 12 * k + 12);
      if (inside.has(k)) centres.push(pose[3], pose[7], pose[11]);
      this.paintFrustum(pose, this.frustum, inside.has(k) ? LOOK.window : LOOK.keyframe, inside.has(k) ? 1.6 : 0.9);
    });
    this.stroke(centres, 3, 0, 0, LOOK.window, 1.2);
  }

  paintFrustum(pose, depth, color, size) {
    const [fx, fy, cx, cy, w, h] = this.data.camera || [1, 1, 0.6, 0.45, 1.2, 0.9], c = this.context;
    const corner = (u, v) => this.project(...at(pose, (u - cx) / fx * depth, (v - cy) / fy * depth, depth));
    const corners = [corner(0, 0), corner(w, 0), corner(w, h), corner(0, h)], tip = this.project(pose[3], pose[7], pose[11]);
    if (tip[2] < 0.02 || corners.some(p => p[2] < 0.02)) return;
    c.beginPath();
    for (const p of corners) { c.moveTo(tip[0], tip[1]); c.lineTo(p[0], p[1]); }
    c.moveTo(corners[3][0], corners[3][1]);
    for (const p of corners) c.lineTo(p[0], p[1]);
    this.ink(color, size);
  }

  paintPoints(pose) {
    const seen = this.pointsOf && this.data.camera ? this.pointsOf(this.frame) : [], [fx, fy, cx, cy] = this.data.camera || [];
    for (const { u, v, depth, share } of seen) {
      if (!depth) continue;
      const [x, y, z] = this.project(...at(pose, (u - cx) / fx * depth, (v - cy) / fy * depth, depth));
      if (z > 0.02) disc(this.context, x, y, 3.6 * this.ratio, this.data.ramp[Math.round(31 * share)], this.ratio);
    }
  }

  listen() {
    const fingers = new Map(), canvas = this.canvas;
    const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
    canvas.addEventListener("contextmenu", event => event.preventDefault());
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => fingers.delete(event.pointerId));
    canvas.addEventListener("pointermove", event => {
      const last = fingers.get(event.pointerId);
      if (!last) return;
      const before = fingers.size > 1 ? spread() : 0, dx = event.clientX - last[0], dy = event.clientY - last[1];
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      this.behind = false;
      if (before) this.distance *= before / Math.max(1, spread());
      if (before || event.buttons & 2 || event.shiftKey) this.pan(dx / Math.max(1, fingers.size), dy / Math.max(1, fingers.size));
      else { this.yaw += 0.006 * dx; this.pitch = Math.max(-1.57, Math.min(1.57, this.pitch + 0.006 * dy)); }
      this.draw();
    });
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.behind = false;
      this.distance *= Math.exp(0.0012 * event.deltaY);
      this.draw();
    }, { passive: false });
  }

  pan(dx, dy) {
    const scale = this.ratio * this.distance / this.focal, { right, up } = this.axes;
    this.target = this.target.map((x, k) => x + scale * (dy * up[k] - dx * right[k]));
  }
}

function at(pose, x, y, z) {
  return [0, 4, 8].map(k => pose[k] * x + pose[k + 1] * y + pose[k + 2] * z + pose[k + 3]);
}

function disc(context, x, y, radius, color, edge) {
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.fillStyle = color; context.fill();
  context.strokeStyle = "#000"; context.lineWidth = edge; context.stroke();
}

const lift = value => Math.min(255, Math.round(40 + 0.95 * value));

function roundStep(length) { // the nearest of 1, 2, 5 times a power of ten
  const power = 10 ** Math.floor(Math.log10(length));
  return [1, 2, 5, 10].map(m => m * power).sort((a, b) => Math.abs(a - length) - Math.abs(b - length))[0];
}
