// SPDX-License-Identifier: Apache-2.0
// The connection to one robot: decodes its frames, keeps its newest state, calls its methods.

const ACKNOWLEDGE = 2;
const RELEASE = 3;
const DRIVE = 1;
const PRESENT = 4;
const AGAIN_MIN_MS = 300;
const AGAIN_MAX_MS = 5000;
const CALL_WITHIN_MS = 15000;
const EVENTS_MAX = 1000;
const ESTOP_WITHIN_MS = 1000;  // it is latched within milliseconds
const ESTOP_AGAIN_MS = 200;
const ESTOP_FOR_MS = 30000;
const STALE_MS = 1000;          // SEEN_MAX_S of seat.py
const STALE_FRAMES = 2.5;       // of a slow rate, so many missing frames
const STATUS_STALE_MS = 5000;
const SILENT_MS = 300;

const SIZES = { B: 1, I: 4, f: 4, d: 8 };
const READERS = {
  B: (view, at) => view.getUint8(at),
  I: (view, at) => view.getUint32(at, true),
  f: (view, at) => view.getFloat32(at, true),
  d: (view, at) => view.getFloat64(at, true),
};

function fieldsOf(rows) {
  let at = 0;
  const fields = rows.map(([name, code]) => {
    const field = { name, read: READERS[code], at };
    at += SIZES[code];
    return field;
  });
  return { fields, bytes: at };
}

const words = (bits, names) =>
  Object.entries(names).filter(([bit]) => (bits >>> Number(bit)) & 1).map(([, word]) => word);

/** Returns the decoder of state frames with that layout. */
export function decoder(layout) {
  const head = fieldsOf(layout.state);
  const joint = fieldsOf(layout.joint);
  return (buffer) => {
    const view = new DataView(buffer);
    const now = {};
    for (const { name, read, at } of head.fields) now[name] = read(view, at);
    const starts = Array.from({ length: now.joints }, (_, at) => head.bytes + at * joint.bytes);
    now.joints = starts.map((start) => {
      const found = {};
      for (const { name, read, at } of joint.fields) found[name] = read(view, start + at);
      return found;
    });
    now.state = layout.states[now.state] ?? "unknown";
    now.rest = layout.rests[now.rest] ?? "unknown";
    layout.flags.forEach((name, bit) => { now[name] = Boolean((now.flags >> bit) & 1); });
    now.reasons = words(now.reasons, layout.reasons);
    now.faults = words(now.faults, layout.faults);
    return now;
  };
}

/** Returns a record of the same form in which nothing is known. */
function unknown(record) {
  const blank = (value) => {
    if (typeof value === "number") return NaN;
    if (typeof value === "string") return "unknown";
    if (!Array.isArray(value)) return null;
    return value.filter((one) => typeof one === "object").map(unknown);
  };
  return Object.fromEntries(Object.entries(record).map(([key, value]) => [key, blank(value)]));
}

function unknownState(state) {
  const blank = unknown(state);
  return { ...blank, joints: blank.joints.map((joint) => ({ ...joint, stale: 1 })) };
}

const pause = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

function base64url(text) {
  const bytes = new TextEncoder().encode(text);
  const base64 = btoa(String.fromCharCode(...bytes));
  return base64.replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
}

function stored(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    return null;
  }
}

function store(key, value) {
  try {
    if (value === null) localStorage.removeItem(key);
    else localStorage.setItem(key, value);
  } catch {
    // storage is switched off: the token lasts as long as the page
  }
}

export class Link {
  /** `address`: address of the dashboard, such as http://robot:8088. */
  constructor(address, rateHz) {
    this.address = address;
    this.rateHz = rateHz;
    this._status = null;
    this._statusAt = -Infinity;
    this.newest = null;       // the newest state, however old: for its stamp, never to be shown
    this._unknown = null;
    this.hello = null;
    this.phase = "connecting"; // connecting, open, refused, lost
    this.why = "";
    this.events = [];
    this.version = 0;         // it changes whenever anything has changed
    this.missed = 0;          // frames that the robot did not send, to keep up
    this.roundTripMs = null;
    this.notDriven = "";
    this._frameAt = -Infinity;
    this._estop = 0;          // number of the newest emergency stop
    this._token = stored(`motord.token.${address}`);
    this._calls = new Map();
    this._number = 0;
    this._againMs = AGAIN_MIN_MS;
    this._listeners = {
      frame: new Set(), hello: new Set(), status: new Set(), refusal: new Set(), trace: new Set(),
      recordings: new Set(),
    };
    this._ended = false;
    this._connect();
  }

  on(kind, listener) {
    this._listeners[kind].add(listener);
    return () => this._listeners[kind].delete(listener);
  }

  _publish(kind, what) {
    for (const listener of this._listeners[kind]) listener(what);
  }

  get token() { return this._token; }

  /** Connects again with a token; null: forgets the token. */
  setToken(token) {
    this._token = token;
    store(`motord.token.${this.address}`, token);
    this._againMs = AGAIN_MIN_MS;
    if (this.phase === "refused") this._connect();
    else this._socket?.close();
  }

  /** Whether what the robot does is unknown. All that shows or changes a state asks `now`, `status`
   *  and `mayCommand`, which ask this. */
  get stale() {
    const rateHz = Math.min(this.rateHz, this.hello?.rate_max_hz ?? this.rateHz);
    const staleMs = Math.max(STALE_MS, (STALE_FRAMES * 1000) / rateHz);
    return this.phase !== "open" || this._ageMs > staleMs;
  }

  get silent() { return this._ageMs > SILENT_MS; }

  get _ageMs() { return performance.now() - this._frameAt; }

  /** The age in whole seconds of the newest state, once that is stale; 0: it is not stale. */
  get staleS() { return this.stale ? Math.ceil(this._ageMs / 1000) : 0; }

  /** The state: when it is stale, one in which nothing is known. null: there was none yet. */
  get now() {
    if (!this.stale || !this.newest) return this.newest;
    return (this._unknown ??= unknownState(this.newest));
  }

  /** The daemon's status, about once a second; null: not known. */
  get status() {
    const old = performance.now() - this._statusAt > STATUS_STALE_MS;
    return this.stale || old ? null : this._status;
  }

  /** The speed limits in force by their keys; null: not known. One without a limit is as in the
   *  robot file. */
  get limits() {
    const known = this.status?.parameters;
    if (!known || !this.hello) return null;
    return Object.fromEntries(Object.entries(this.hello.limits).map(([key, own]) =>
      [key, known[`limits.${key}`] ?? own]));
  }

  /** Whether this page is permitted to command the robot. */
  get permitted() { return this.phase === "open" && Boolean(this.hello?.may_command); }

  /** Whether it may do so now. An emergency stop does not ask this. */
  get mayCommand() { return this.permitted && !this.stale; }

  get mayEstop() { return this.phase !== "refused" && (this.hello?.may_command ?? true); }

  setRate(rateHz) {
    this.rateHz = rateHz;
    if (this.phase === "open") this._sendText({ rate_hz: rateHz });
  }

  end() {
    this._ended = true;
    clearTimeout(this._timer);
    this._socket?.close();
  }

  _connect() {
    clearTimeout(this._timer);
    const protocols = ["motord.1"];
    if (this._token) protocols.push(`token.${base64url(this._token)}`);
    const socket = new WebSocket(`${this.address.replace(/^http/, "ws")}/socket`, protocols);
    socket.binaryType = "arraybuffer";
    this._socket = socket;
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") this._take(JSON.parse(data));
      else this._takeFrame(data);
    };
    socket.onclose = () => this._closed(socket);
  }

  _closed(socket) {
    if (socket !== this._socket) return;
    for (const { reject } of this._calls.values()) reject(new Error("the connection was lost"));
    this._calls.clear();
    if (this.phase !== "refused") {
      this.phase = "lost";
      if (!this._ended) this._timer = setTimeout(() => this._connect(), this._againMs);
      this._againMs = Math.min(2 * this._againMs, AGAIN_MAX_MS);
    }
    this.version += 1;
  }

  _takeFrame(data) {
    if (!this._decode) return;
    const now = this._decode(data);
    this.newest = now;
    this._unknown = null;
    this._frameAt = performance.now();
    this.version += 1;
    this._send(numbered(ACKNOWLEDGE, now.sequence));
    this._publish("frame", now);
  }

  _take(message) {
    this.version += 1;
    if (message.hello) this._open(message.hello);
    else if (message.status) {
      this._status = message.status;
      this._statusAt = performance.now();
      this._publish("status", message.status);
    } else if ("dropped" in message) this.missed = message.dropped;
    else if (message.event) this._addEvents([message.event]);
    else if (message.parameters) this._note(message.parameters);
    else if (message.recordings) this._publish("recordings", message.recordings);
    else if (message.trace) this._publish("trace", message.trace);
    else if (message.commissioning) this._commissioned(message.commissioning);
    else if ("progress" in message) this.progress = message.progress;
    else if ("answer" in message) this._answered(message);
    else if (message.refused) {
      this.phase = "refused";
      this.why = message.refused;
    } else if (message.not_driven) {
      this.notDriven = message.not_driven;
      this._publish("refusal", message.not_driven);
    }
  }

  _open(hello) {
    this.hello = hello;
    this._decode = decoder(hello.layout);
    this.phase = "open";
    this.why = "";
    this._againMs = AGAIN_MIN_MS;
    this.events = [];
    this.commissioning = null;
    this.progress = "";
    this._addEvents(hello.events);
    this.setRate(Math.min(this.rateHz, hello.rate_max_hz));
    this._publish("hello", hello);
  }

  _commissioned(record) {
    this.commissioning = record;
    if (record.question || record.end) this.progress = "";
  }

  /** Notes parameters that a page has set, before a status has them. */
  _note(parameters) {
    if (this._status) Object.assign(this._status.parameters, parameters);
  }

  _addEvents(events) {
    this.events = [...this.events, ...events].slice(-EVENTS_MAX);
  }

  /** Calls a method of the robot. Rejects with an Error that has the reason. */
  call(method, params = {}, withinMs = CALL_WITHIN_MS) {
    if (this.phase !== "open") return Promise.reject(new Error("there is no connection"));
    const id = (this._number += 1);
    const began = performance.now();
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => {
        this._calls.delete(id);
        reject(new Error("no answer"));
      }, withinMs);
      const done = (end) => (value) => {
        clearTimeout(timer);
        if (method === "status") this.roundTripMs = performance.now() - began;
        end(value);
      };
      this._calls.set(id, { resolve: done(resolve), reject: done(reject) });
      this._sendText({ id, call: method, params });
    });
  }

  _answered({ answer, result, error, needs_force: needsForce = false }) {
    const call = this._calls.get(answer);
    this._calls.delete(answer);
    if (error === undefined) call?.resolve(result);
    else call?.reject(Object.assign(new Error(error), { answered: true, needsForce }));
  }

  /** Requests an emergency stop, again until the robot answers or ESTOP_FOR_MS have passed.
   *  `report` gets why it is not confirmed yet, and nothing once it is. */
  async estop(report) {
    const press = (this._estop += 1);
    const untilMs = performance.now() + ESTOP_FOR_MS;
    if (this.stale) report("no state comes from the robot");
    for (;;) {
      try {
        await this.call("estop", {}, ESTOP_WITHIN_MS);
        return report("");
      } catch (error) {
        if (press !== this._estop) return undefined;
        report(error.message);
        if (error.answered || performance.now() > untilMs) return undefined;
      }
      await pause(ESTOP_AGAIN_MS);
    }
  }

  /** Sends one command of the hold `press`. */
  drive(press, { linear, lateral, angular }) {
    const view = new DataView(new ArrayBuffer(45));
    view.setUint8(0, DRIVE);
    view.setUint32(1, press, true);
    const seenS = this.newest?.stamp_s ?? 0;
    [performance.now(), seenS, linear, lateral, angular].forEach((value, place) =>
      view.setFloat64(5 + 8 * place, value, true));
    this._send(view.buffer);
  }

  /** Reports that this page is visible and shows the newest state. */
  present() {
    const view = new DataView(new ArrayBuffer(17));
    view.setUint8(0, PRESENT);
    view.setFloat64(1, performance.now(), true);
    view.setFloat64(9, this.newest?.stamp_s ?? 0, true);
    this._send(view.buffer);
  }

  release(press) { this._send(numbered(RELEASE, press)); }

  _sendText(message) { this._send(JSON.stringify(message)); }

  _send(data) {
    if (this._socket?.readyState === WebSocket.OPEN) this._socket.send(data);
  }
}

function numbered(kind, number) {
  const view = new DataView(new ArrayBuffer(5));
  view.setUint8(0, kind);
  view.setUint32(1, number, true);
  return view.buffer;
}
