// The map: metres to pixels, pan and zoom, the path by validity, the robot with its 99 % circle and ellipse.

import { isNumber } from "./format.js";

const CHI_99 = Math.sqrt(9.2103); // two degrees of freedom
const BREAK_S = 1.5; // poses further apart are not joined by a line
const COLOURS = ["--initialising", "--accent", "--degraded", "--invalid"];
const [LEAST_SCALE, MOST_SCALE] = [1e-3, 5e4]; // pixels per metre

export class PathMap {
  /** `onFree()` is called when the user takes the view into his own hands. */
  constructor(canvas, onFree) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.onFree = onFree;
    [this.x, this.y, this.scale] = [0, 0, 40]; // metres at the middle, pixels per metre
    this.mode = "fit"; // fit, follow, free
    this.pointers = new Map();
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    }
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const other = [...this.pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
    this.pointers.set(event.pointerId, event);
    if (other) {
      const was = Math.hypot(before.offsetX - other.offsetX, before.offsetY - other.offsetY);
      const is = Math.hypot(event.offsetX - other.offsetX, event.offsetY - other.offsetY);
      this.zoom(is / Math.max(was, 1), (event.offsetX + other.offsetX) / 2, (event.offsetY + other.offsetY) / 2);
      return;
    }
    this.x -= (event.offsetX - before.offsetX) / this.scale;
    this.y += (event.offsetY - before.offsetY) / this.scale;
    this.free();
  }

  zoom(factor, px = this.canvas.clientWidth / 2, py = this.canvas.clientHeight / 2) {
    const scale = Math.min(MOST_SCALE, Math.max(LEAST_SCALE, this.scale * factor));
    const [dx, dy] = [px - this.canvas.clientWidth / 2, py - this.canvas.clientHeight / 2];
    if (this.mode !== "follow") {
      this.x += dx / this.scale - dx / scale;
      this.y -= dy / this.scale - dy / scale;
    }
    this.scale = scale;
    this.free(this.mode === "follow");
  }

  free(follows = false) {
    this.mode = follows ? "follow" : "free";
    this.onFree();
  }

  /** Draw rows (oldest first, see page.js) with the robot at `at`; what is later than `at` is faint. */
  draw(rows, at) {
    const { canvas, context: c } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    if (this.mode === "fit") this.fit(rows, at, width, height);
    if (this.mode === "follow" && at) [this.x, this.y] = [at.x, at.y];
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(name).trim();
    this.sx = (x) => width / 2 + (x - this.x) * this.scale;
    this.sy = (y) => height / 2 - (y - this.y) * this.scale;
    this.grid(width, height);
    this.path(rows, at);
    if (at) this.robot(at);
  }

  fit(rows, at, width, height) {
    let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
    const hold = (x, y, r) => {
      left = Math.min(left, x - r);
      right = Math.max(right, x + r);
      bottom = Math.min(bottom, y - r);
      top = Math.max(top, y + r);
    };
    for (const row of rows) hold(row.x, row.y, 0);
    if (at) hold(at.x, at.y, 0);
    if (left > right) return;
    // A bound far larger than the run must not make the run a dot.
    if (at) hold(at.x, at.y, Math.min(at.bound, Math.max(5, right - left, top - bottom)));
    [this.x, this.y] = [(left + right) / 2, (bottom + top) / 2];
    const margin = 54; // pixels: buttons, legend and figures at the edges
    const scale = Math.min((width - 2 * margin) / Math.max(right - left, 2), (height - 2 * margin) / Math.max(top - bottom, 2));
    this.scale = Math.min(MOST_SCALE, Math.max(LEAST_SCALE, scale));
  }

  grid(width, height) {
    const c = this.context;
    const raw = 80 / this.scale; // metres in about 80 pixels
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find((n) => n * power >= raw) * power;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    c.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    c.lineWidth = 1;
    const [left, top] = [this.x - width / 2 / this.scale, this.y + height / 2 / this.scale];
    const line = (x1, y1, x2, y2, isAxis) => {
      c.strokeStyle = this.colour(isAxis ? "--grid-strong" : "--grid");
      c.beginPath();
      c.moveTo(x1, y1);
      c.lineTo(x2, y2);
      c.stroke();
    };
    const label = (metres) => metres.toFixed(digits).replace("-", "−");
    for (let i = Math.ceil(left / step); this.sx(i * step) < width; i++) {
      const px = Math.round(this.sx(i * step)) + 0.5;
      line(px, 0, px, height, i === 0);
      c.fillStyle = this.colour("--quiet");
      c.textAlign = "center";
      if (px > 46 && px < width - 34) c.fillText(label(i * step), px, height - 7);
    }
    for (let i = Math.floor(top / step); this.sy(i * step) < height; i--) {
      const py = Math.round(this.sy(i * step)) + 0.5;
      line(0, py, width, py, i === 0);
      c.fillStyle = this.colour("--quiet");
      c.textAlign = "left";
      if (py > 52 && py < height - 22) c.fillText(label(i * step), 7, py - 4);
    }
    c.textAlign = "right";
    c.fillText("m", width - 8, height - 7);
  }

  path(rows, at) {
    const c = this.context;
    c.lineWidth = 2;
    c.lineJoin = c.lineCap = "round";
    let [last, drawn, open] = [null, null, false];
    const finish = () => {
      if (open) c.stroke();
      open = false;
    };
    for (const row of rows) {
      const later = at !== null && row.t > at.t + 1e-6;
      const joined = last && row.t - last.t < BREAK_S && Math.hypot(row.x - last.x, row.y - last.y) < leap(last, row);
      const style = `${row.validity}${later}`;
      const [px, py] = [this.sx(row.x), this.sy(row.y)];
      if (!joined || style !== drawn?.style) {
        finish();
        c.strokeStyle = this.colour(COLOURS[row.validity] ?? "--quiet");
        c.globalAlpha = later ? 0.22 : 1;
        c.beginPath();
        if (joined) c.moveTo(this.sx(last.x), this.sy(last.y));
        else c.moveTo(px, py);
        c.lineTo(px, py);
        [open, drawn] = [true, { style, px, py }];
      } else if (Math.abs(px - drawn.px) + Math.abs(py - drawn.py) > 1.2) {
        c.lineTo(px, py);
        drawn = { style, px, py };
      }
      last = row;
    }
    finish();
    c.globalAlpha = 1;
  }

  robot(at) {
    const c = this.context;
    const [px, py] = [this.sx(at.x), this.sy(at.y)];
    c.strokeStyle = c.fillStyle = this.colour(COLOURS[at.validity] ?? "--accent");
    c.lineWidth = 1;
    if (isNumber(at.bound)) {
      c.beginPath();
      c.arc(px, py, Math.min(1e5, at.bound * this.scale), 0, 2 * Math.PI);
      c.globalAlpha = 0.12;
      c.fill();
      c.globalAlpha = 0.8;
      c.stroke();
    }
    this.ellipse(at, px, py);
    c.globalAlpha = 1;
    c.save();
    c.translate(px, py);
    c.rotate(-at.heading);
    c.beginPath();
    c.moveTo(13, 0);
    c.lineTo(-8, -8);
    c.lineTo(-4, 0);
    c.lineTo(-8, 8);
    c.closePath();
    c.strokeStyle = this.colour("--panel");
    c.lineWidth = 4;
    c.stroke();
    c.fillStyle = this.colour("--ink");
    c.fill();
    c.restore();
  }

  ellipse(at, px, py) {
    const c = this.context;
    const [middle, half] = [(at.xx + at.yy) / 2, Math.hypot((at.xx - at.yy) / 2, at.xy)];
    const radii = [middle + half, middle - half].map((v) => Math.min(1e5, CHI_99 * Math.sqrt(Math.max(0, v)) * this.scale));
    if (!radii.every(Number.isFinite)) return;
    c.beginPath();
    c.ellipse(px, py, radii[0], radii[1], -0.5 * Math.atan2(2 * at.xy, at.xx - at.yy), 0, 2 * Math.PI);
    c.setLineDash([5, 4]);
    c.lineWidth = 1.5;
    c.stroke();
    c.setLineDash([]);
  }
}

// A longer way between two rows is no motion but a new pose: set_pose or reset.
function leap(a, b) {
  return 1 + 3 * Math.max(Math.abs(a.speed), Math.abs(b.speed)) * (b.t - a.t);
}
