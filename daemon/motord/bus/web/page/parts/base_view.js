// SPDX-License-Identifier: Apache-2.0
// The base from above on a grid: x of the odometry to the right, y upwards.

import { html, useEffect, useRef, useState } from "../vendor/htm-preact.js";
import { SYMBOLS, TEXT } from "../text.js";
import { colour } from "./parts.js";

const TRAIL_MAX = 4000;
const TRAIL_STEP_M = 0.01;
const AHEAD_S = 0.5;         // an arrow shows the distance of a speed in this time
const STEPS_M = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];
const GRID_PX = 48;

export class Trail {
  constructor(link) {
    this.points = [];
    link.on("hello", () => this.clear());
    link.on("frame", (now) => this._add(now));
  }

  clear() { this.points = []; }

  _add({ x_m, y_m }) {
    const last = this.points[this.points.length - 1];
    const step = last ? Math.hypot(x_m - last[0], y_m - last[1]) : Infinity;
    if (!(step >= TRAIL_STEP_M)) return;
    if (step > 1 && last) this.points = [];  // the pose was reset
    this.points.push([x_m, y_m]);
    if (this.points.length > TRAIL_MAX) this.points.splice(0, TRAIL_MAX / 4);
  }
}

function arrow(paint, fromX, fromY, toX, toY, width) {
  const length = Math.hypot(toX - fromX, toY - fromY);
  if (!(length > 2)) return;
  const angle = Math.atan2(toY - fromY, toX - fromX);
  const head = Math.min(4 + 2 * width, length);
  paint.lineWidth = width;
  paint.beginPath();
  paint.moveTo(fromX, fromY);
  paint.lineTo(toX - 0.7 * head * Math.cos(angle), toY - 0.7 * head * Math.sin(angle));
  paint.stroke();
  paint.beginPath();
  paint.moveTo(toX, toY);
  for (const side of [-1, 1]) {
    const turned = angle + side * 0.42;
    paint.lineTo(toX - head * Math.cos(turned), toY - head * Math.sin(turned));
  }
  paint.fill();
}

/** Returns the direction of a wheel in the base; NaN: nothing measures its steering angle. */
export function directionOf(wheel, hello, now) {
  if (wheel.steered_by === null) return wheel.heading_rad;
  const steering = now.joints[hello.joints.indexOf(wheel.steered_by)];
  return wheel.heading_rad + (steering?.position_rad ?? NaN);
}

/** Returns what the picture shows of a state, no finer than an eye can see. The picture is drawn
 *  again only when this differs. */
function shownOf(hello, now) {
  const wheels = hello.wheels.map((wheel) => {
    const joint = now.joints[hello.joints.indexOf(wheel.joint)];
    if (!joint) return "";
    return [joint.stale, directionOf(wheel, hello, now).toFixed(3), joint.setpoint_rad_s.toFixed(2),
      joint.velocity_rad_s.toFixed(2)].join();
  });
  const twist = [now.setpoint_linear_m_s, now.setpoint_lateral_m_s, now.setpoint_angular_rad_s,
    now.linear_m_s, now.lateral_m_s, now.angular_rad_s].map((value) => value.toFixed(3));
  const pose = [now.x_m, now.y_m, now.heading_rad].map((value) => value.toFixed(3));
  return [...pose, ...twist, ...wheels].join(" ");
}

class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    this.paint = canvas.getContext("2d");
    this.zoom = 1;
    this.shown = null;
  }

  /** Returns whether this state needs another picture than the one that is drawn. */
  differs(hello, now) { return !hello || shownOf(hello, now) !== this.shown; }

  draw(hello, now, trail) {
    const { canvas, paint } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== columns || canvas.height !== rows) {
      canvas.width = columns;
      canvas.height = rows;
    }
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint.clearRect(0, 0, width, height);
    this.shown = hello && now ? shownOf(hello, now) : null;
    if (this.shown === null) return;
    const reach = Math.max(0.1, ...hello.wheels.map((wheel) =>
      Math.hypot(Math.abs(wheel.x_m) + wheel.radius_m, wheel.y_m)));
    const scale = (this.zoom * Math.min(width, height)) / (reach * 6);
    const at = (x, y) => [width / 2 + (x - now.x_m) * scale, height / 2 - (y - now.y_m) * scale];
    this._grid(width, height, scale, now);
    this._trail(trail, at);
    paint.save();
    paint.translate(width / 2, height / 2);
    paint.rotate(-now.heading_rad);
    this._base(hello, now, scale);
    paint.restore();
  }

  _grid(width, height, scale, now) {
    const { paint } = this;
    const step = STEPS_M.find((m) => m * scale >= GRID_PX) ?? 100;
    paint.strokeStyle = colour("grid");
    paint.lineWidth = 1;
    paint.beginPath();
    const left = now.x_m - width / 2 / scale;
    const bottom = now.y_m - height / 2 / scale;
    for (let x = Math.ceil(left / step) * step; (x - left) * scale < width; x += step) {
      const px = Math.round((x - left) * scale) + 0.5;
      paint.moveTo(px, 0);
      paint.lineTo(px, height);
    }
    for (let y = Math.ceil(bottom / step) * step; (y - bottom) * scale < height; y += step) {
      const py = Math.round(height - (y - bottom) * scale) + 0.5;
      paint.moveTo(0, py);
      paint.lineTo(width, py);
    }
    paint.stroke();
    paint.strokeStyle = paint.fillStyle = colour("muted");
    paint.lineWidth = 2;
    paint.beginPath();
    paint.moveTo(12, height - 18);
    paint.lineTo(12, height - 12);
    paint.lineTo(12 + step * scale, height - 12);
    paint.lineTo(12 + step * scale, height - 18);
    paint.stroke();
    paint.font = "12px system-ui, sans-serif";
    paint.fillText(`${step} ${SYMBOLS.m}`, 18, height - 18);
  }

  _trail(trail, at) {
    const { paint } = this;
    paint.strokeStyle = colour("trail");
    paint.lineWidth = 2;
    paint.lineJoin = "round";
    paint.beginPath();
    trail.points.forEach(([x, y], place) => {
      const [px, py] = at(x, y);
      if (place) paint.lineTo(px, py);
      else paint.moveTo(px, py);
    });
    paint.stroke();
  }

  // Forward x is to the right here and left y is up: the canvas' y has the opposite sign.
  _base(hello, now, scale) {
    const { paint } = this;
    const wheels = hello.wheels;
    const xs = wheels.flatMap(({ x_m, radius_m }) => [x_m - 1.5 * radius_m, x_m + 1.5 * radius_m]);
    const ys = wheels.map(({ y_m }) => y_m);
    const [front, back] = [Math.max(...xs), Math.min(...xs)];
    const side = Math.max(...ys.map(Math.abs), 0.6 * (front - back) / 2) - 0.3 * wheels[0].radius_m;
    paint.fillStyle = colour("body");
    paint.strokeStyle = colour("outline");
    paint.lineWidth = 1.5;
    paint.beginPath();
    const round = Math.max(...wheels.map(({ x_m, y_m }) => Math.hypot(x_m, y_m)));
    if (hello.kind === "omni") paint.arc(0, 0, round * scale, 0, 2 * Math.PI);
    else paint.roundRect(back * scale, -side * scale, (front - back) * scale, 2 * side * scale, 8);
    paint.fill();
    paint.stroke();
    paint.fillStyle = colour("outline");
    const nose = (hello.kind === "omni" ? round : front) * scale;
    paint.beginPath();
    paint.moveTo(nose - 4, 0);
    paint.lineTo(nose - 14, -7);
    paint.lineTo(nose - 14, 7);
    paint.fill();
    wheels.forEach((wheel) => this._wheel(wheel, hello, now, scale));
    this._twist(now, scale);
  }

  _wheel(wheel, hello, now, scale) {
    const { paint } = this;
    const joint = now.joints[hello.joints.indexOf(wheel.joint)];
    if (!joint) return;
    const radius = wheel.radius_m * scale;
    paint.save();
    paint.translate(wheel.x_m * scale, -wheel.y_m * scale);
    const direction = directionOf(wheel, hello, now);
    const known = Number.isFinite(direction);
    paint.rotate(known ? -direction : -wheel.heading_rad);
    paint.fillStyle = paint.strokeStyle = colour(joint.stale ? "error" : "wheel");
    paint.lineWidth = 2;
    paint.beginPath();
    paint.roundRect(-radius, -0.4 * radius, 2 * radius, 0.8 * radius, 0.25 * radius);
    if (known) paint.fill();
    else paint.stroke();
    if (wheel.roller_rad !== null) this._rollers(radius, wheel.roller_rad - wheel.heading_rad);
    const rolls = wheel.joint !== wheel.steered_by;  // a joint that steers rolls no wheel
    const ahead = rolls ? radius * AHEAD_S : 0;
    paint.strokeStyle = paint.fillStyle = colour("setpoint");
    arrow(paint, 0, 0, joint.setpoint_rad_s * ahead, 0, 5);
    paint.strokeStyle = paint.fillStyle = colour("speed");
    arrow(paint, 0, 0, joint.velocity_rad_s * ahead, 0, 2);
    paint.restore();
  }

  _rollers(radius, turned) {
    const { paint } = this;
    const [x, y] = [0.4 * radius * Math.cos(turned), -0.4 * radius * Math.sin(turned)];
    paint.strokeStyle = colour("body");
    paint.lineWidth = 1.5;
    paint.beginPath();
    for (const at of [-0.55, 0, 0.55]) {
      paint.moveTo(at * radius - x, -y);
      paint.lineTo(at * radius + x, y);
    }
    paint.stroke();
  }

  _twist(now, scale) {
    const { paint } = this;
    const setpoint =
      [now.setpoint_linear_m_s, now.setpoint_lateral_m_s, now.setpoint_angular_rad_s];
    const speed = [now.linear_m_s, now.lateral_m_s, now.angular_rad_s];
    for (const [name, width, linear, lateral, angular] of [
      ["setpoint", 5, ...setpoint],
      ["speed", 2, ...speed],
    ]) {
      paint.strokeStyle = paint.fillStyle = colour(name);
      arrow(paint, 0, 0, linear * AHEAD_S * scale, -lateral * AHEAD_S * scale, width);
      if (Math.abs(angular) > 0.02) {
        paint.lineWidth = width;
        paint.beginPath();
        paint.arc(0, 0, 20, 0, -angular * AHEAD_S, angular > 0);
        paint.stroke();
      }
    }
    paint.fillStyle = colour("outline");
    paint.beginPath();
    paint.arc(0, 0, 3, 0, 2 * Math.PI);
    paint.fill();
  }
}

export function BaseView({ link, trail }) {
  const canvas = useRef(null);
  const painter = useRef(null);
  const [, render] = useState(0);
  useEffect(() => {
    painter.current = new Painter(canvas.current);
    let frame = 0;
    const draw = () => {
      frame = 0;
      painter.current.draw(link.hello, link.now, trail);
    };
    const soon = () => { frame ||= requestAnimationFrame(draw); };
    const moved = (now) => { if (painter.current.differs(link.hello, now)) soon(); };
    const ends = [link.on("frame", moved), link.on("hello", soon)];
    const size = new ResizeObserver(soon);
    size.observe(canvas.current);
    document.addEventListener("motord-theme", soon);
    return () => {
      cancelAnimationFrame(frame);
      ends.forEach((end) => end());
      size.disconnect();
      document.removeEventListener("motord-theme", soon);
    };
  }, [link, trail]);
  useEffect(() => { painter.current.draw(link.hello, link.now, trail); }, [link.stale]);
  const zoom = (factor) => {
    painter.current.zoom = Math.min(8, Math.max(0.1, painter.current.zoom * factor));
    render(painter.current.zoom);
    painter.current.draw(link.hello, link.now, trail);
  };
  const clear = () => {
    trail.clear();
    zoom(1);
  };
  return html`<div class="base-view">
    <canvas ref=${canvas} role="img" aria-label=${TEXT.baseView}></canvas>
    <ul class="legend">
      <li class="speed">${TEXT.legend.speed}</li><li class="setpoint">${TEXT.legend.setpoint}</li>
      <li class="trail">${TEXT.legend.trail}</li>
    </ul>
    <div class="zoom">
      <button aria-label=${TEXT.zoomIn} title=${TEXT.zoomIn} onClick=${() => zoom(1.4)}>+</button>
      <button aria-label=${TEXT.zoomOut} title=${TEXT.zoomOut}
        onClick=${() => zoom(1 / 1.4)}>−</button>
      <button aria-label=${TEXT.clearTrail} title=${TEXT.clearTrail} onClick=${clear}>⌫</button>
    </div>
  </div>`;
}
