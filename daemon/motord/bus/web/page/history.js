// SPDX-License-Identifier: Apache-2.0
// The last minute of a robot in ring buffers of a fixed size.

const JOINT = {
  velocity: "velocity_rad_s", setpoint: "setpoint_rad_s", position: "position_rad",
  current: "current_a", voltage: "voltage_v", temperature: "temperature_c", age: "feedback_age_s",
};
const MEASURED = ["velocity", "position", "current", "voltage", "temperature"];
const MEASURED_BASE = ["linear_m_s", "lateral_m_s", "angular_rad_s"];
const BASE = [
  "linear_m_s", "lateral_m_s", "angular_rad_s",
  "setpoint_linear_m_s", "setpoint_lateral_m_s", "setpoint_angular_rad_s",
];
export const SECONDS = 60;
const OLD_S = 0.5;  // what was measured before this, and a time without states, is a gap

class Ring {
  constructor(names, size) {
    this.size = size;
    this.count = 0;
    this.time = new Float64Array(size);
    this.series = Object.fromEntries(names.map((name) => [name, new Float64Array(size)]));
  }

  add(time, values) {
    const place = this.count % this.size;
    this.time[place] = time;
    for (const name in this.series) this.series[name][place] = values(name);
    this.count += 1;
  }

  /** Returns the time and these series in order, for uPlot; a value that was not measured is null.
   *  Series without a null are typed arrays: an array that may hold null boxes each of its numbers,
   *  thousands of them for each picture. */
  data(names, sinceS) {
    const have = Math.min(this.count, this.size);
    const first = this.count - have;
    let from = first;
    while (from < this.count && this.time[from % this.size] < sinceS) from += 1;
    const pick = (ring) => {
      const out = new Float64Array(this.count - from);
      for (let at = from; at < this.count; at += 1) out[at - from] = ring[at % this.size];
      if (out.every(Number.isFinite)) return out;
      return Array.from(out, (value) => (Number.isFinite(value) ? value : null));
    };
    return [pick(this.time), ...names.map((name) => pick(this.series[name]))];
  }

  get newest() { return this.count ? this.time[(this.count - 1) % this.size] : 0; }
}

export class History {
  constructor(link) {
    this.link = link;
    this.fast = null;
    this.slow = null;
    link.on("hello", (hello) => this._begin(hello));
    link.on("frame", (now) => this._add(now));
    link.on("status", (status) => this._addStatus(status));
  }

  _begin(hello) {
    const keys = Object.keys(JOINT);
    const joints = hello.joints.flatMap((_, place) => keys.map((key) => `${key}.${place}`));
    const rateHz = Math.max(50, Math.ceil(hello.rate_max_hz));
    this.fast = new Ring([...BASE, ...joints], SECONDS * rateHz);
    this.slow = null;
    this._lateness = [];
  }

  _add(now) {
    if (!this.fast || now.stamp_s <= this.fast.newest) return;
    const { newest } = this.fast;
    if (newest && now.stamp_s - newest > OLD_S) this.fast.add(newest + OLD_S, () => NaN);
    const old = now.joints.map((joint) => !(joint.feedback_age_s <= OLD_S));
    const waits = now.joints.some((joint, place) => !joint.stale && old[place]);
    this.fast.add(now.stamp_s, (name) => {
      const [key, place] = name.split(".");
      if (place === undefined) return waits && MEASURED_BASE.includes(key) ? NaN : now[key];
      return old[place] && MEASURED.includes(key) ? NaN : now.joints[place]?.[JOINT[key]];
    });
  }

  _addStatus(status) {
    const lines = Object.keys(status.lines);
    const names = lines.flatMap((line) => [`p50 ${line}`, `p99 ${line}`, `errors ${line}`]);
    if (!this.slow) this.slow = new Ring(names, 600);
    const time = this.link.newest?.stamp_s ?? 0;
    if (time <= this.slow.newest) return;
    this.slow.add(time, (name) => {
      const [what, ...rest] = name.split(" ");
      const line = status.lines[rest.join(" ")];
      if (!line) return NaN;
      if (what === "errors") return Object.values(line.errors).reduce((sum, n) => sum + n, 0);
      return line.round_trip_us[what] ?? NaN;
    });
  }

  /** Adds the loop's lateness; returns the buckets of the last minute: [low_us, high_us, count]. */
  addLateness(latency) {
    const at = performance.now();
    const rows = latency.buckets.lateness;
    this._lateness.push({ at, counts: new Map(rows.map(([low, , n]) => [low, n])) });
    while (this._lateness.length > 2 && at - this._lateness[1].at > SECONDS * 1000) {
      this._lateness.shift();
    }
    const before = this._lateness.length > 1 ? this._lateness[0].counts : new Map();
    return rows
      .map(([low, high, n]) => [low / 1e3, high / 1e3, n - (before.get(low) ?? 0)])
      .filter(([, , n]) => n > 0);
  }

  /** Returns the last minute as comma-separated values, with the units in the names. */
  csv() {
    const joints = this.link.hello.joints;
    const names = Object.keys(this.fast.series);
    const title = (name) => {
      const [key, place] = name.split(".");
      return place === undefined ? key : `${joints[place]}.${JOINT[key]}`;
    };
    const columns = this.fast.data(names, 0);
    const rows = Array.from(columns[0], (_, row) =>
      columns.map((column) => column[row] ?? "").join(","));
    return [["stamp_s", ...names.map(title)].join(","), ...rows].join("\n") + "\n";
  }
}
