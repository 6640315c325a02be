// SPDX-License-Identifier: Apache-2.0
// Sends commands while the pad, a key or a button is held, and stops as soon as it may be released.
// When this page sends nothing any more, the lease in the daemon guarantees the stop. Anything that
// takes the keyboard or the mouse from a page with the focus has to end a hold here: the browser
// does not report the release to the page then, and the page would send for ever.

const EVERY_MS = 50;

export class Pilot {
  constructor(link) {
    this.link = link;
    this.press = 0;
    this.holder = null;      // "pad", "keys" or "gamepad"
    this.share = { linear: 0, lateral: 0, angular: 0 };  // parts of the limits, -1 to 1
    this.limiter = 0.4;
    this.released = "";      // why the last hold ended by itself
    this.onEnd = new Set();  // listeners: keys that are still down must not begin another hold
    // Not in the capturing phase: the pad prevents a menu, so a long touch does not end its hold.
    window.addEventListener("contextmenu", (event) => event.defaultPrevented || this.end("taken"));
    window.addEventListener("dragstart", () => this.end("taken"), true);
    window.addEventListener("beforeprint", () => this.end("taken"));
    window.addEventListener("blur", () => this.end("blur"));
    window.addEventListener("pagehide", () => this.end("hidden"));
    document.addEventListener("visibilitychange", () => document.hidden && this.end("hidden"));
    link.on("refusal", (why) => this._refused(why));
  }

  get held() { return this.holder !== null; }

  /** The command in metres and radians a second. */
  get wanted() {
    const limits = this.link.limits;
    const part = (key, unit) => (limits ? this.share[key] * this.limiter * limits[unit] : 0);
    return {
      linear: part("linear", "linear_m_s"),
      lateral: part("lateral", "lateral_m_s"),
      angular: part("angular", "angular_rad_s"),
    };
  }

  hold(holder, share) {
    if (this.holder !== null && this.holder !== holder) return;
    this.share = share;
    if (this.holder === null) {
      if (!this.link.mayCommand || document.hidden) return;
      this.holder = holder;
      this.press += 1;
      this.released = "";
      document.documentElement.dataset.held = holder;
      this._timer = setInterval(() => this._send(), EVERY_MS);
    }
    this._send();
  }

  /** Notes why a press begins no hold. */
  refuse(why) {
    this.released = why;
    this.link.version += 1;
  }

  /** Ends the hold, if it is that of `holder`. */
  letGo(holder) {
    if (this.holder === holder) this.end("");
  }

  end(why) {
    for (const listener of this.onEnd) listener();  // also without a hold: keys may be down
    if (this.holder === null) return;
    clearInterval(this._timer);
    this.holder = null;
    delete document.documentElement.dataset.held;
    this.share = { linear: 0, lateral: 0, angular: 0 };
    this.released = why;
    this.link.release(this.press);
    this.link.version += 1;
  }

  _refused(why) {
    if (this.holder === null) return;
    this.end("");
    this.released = why;
  }

  _send() {
    if (this.link.phase !== "open" || this.link.silent) this.end("lost");
    else if (this.holder !== null) this.link.drive(this.press, this.wanted);
  }
}
