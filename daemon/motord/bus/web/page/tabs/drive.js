// SPDX-License-Identifier: Apache-2.0
// The pad, the keys and the gamepad.

import { html, useEffect, useRef, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, measure, Rows, useLink } from "../parts/parts.js";
import { commander, StateCard } from "./overview.js";
import { BaseView } from "../parts/base_view.js";
import { useGamepad } from "../parts/gamepad.js";

const KEYS = {
  KeyW: ["linear", 1], ArrowUp: ["linear", 1],
  KeyS: ["linear", -1], ArrowDown: ["linear", -1],
  KeyA: ["angular", 1], ArrowLeft: ["angular", 1],
  KeyD: ["angular", -1], ArrowRight: ["angular", -1],
  KeyQ: ["lateral", 1], KeyE: ["lateral", -1],
};
const REST = { linear: 0, lateral: 0, angular: 0 };

const clipped = (value) => Math.min(1, Math.max(-1, value));
const typing = (target) => target.matches?.("input:not([type=range]), select, textarea");

function useKeys(pilot) {
  useEffect(() => {
    const held = new Set();
    const hold = () => {
      const share = { ...REST };
      for (const code of held) {
        const [axis, step] = KEYS[code];
        share[axis] = clipped(share[axis] + step);
      }
      if (held.size) pilot.hold("keys", share);
      else pilot.letGo("keys");
    };
    const take = () => {
      held.clear();
      if (pilot.holder === "keys") pilot.end("taken");
    };
    const down = (event) => {
      // The key may open a menu of the browser or of the system, which gets the keyup. macOS sends
      // no keyup while Meta is down.
      if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return take();
      if (typing(event.target)) return;
      if (event.target.matches?.("input[type=range]") && event.code.startsWith("Arrow")) return;
      event.preventDefault();
      if (event.repeat) return;
      held.add(event.code);
      hold();
    };
    const up = (event) => {
      if (event.metaKey) take();
      else if (held.delete(event.code)) hold();
    };
    // Firefox opens its menu without an event when Shift is down.
    const button = (event) => event.button !== 0 && take();
    const forget = () => held.clear();
    const listeners =
      Object.entries({ keydown: down, keyup: up, mousedown: button, contextmenu: take });
    for (const [kind, listener] of listeners) window.addEventListener(kind, listener, true);
    pilot.onEnd.add(forget);
    return () => {
      for (const [kind, listener] of listeners) window.removeEventListener(kind, listener, true);
      pilot.onEnd.delete(forget);
      pilot.letGo("keys");
    };
  }, [pilot]);
}

function Pad({ pilot, sideways }) {
  const pad = useRef(null);
  const pointer = useRef(null);  // the pointer that touched the pad last
  const share = (event) => {
    const box = pad.current.getBoundingClientRect();
    const radius = box.width / 2;
    let x = (event.clientX - box.left - radius) / radius;
    let y = (event.clientY - box.top - radius) / radius;
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    return { linear: -y, angular: sideways ? 0 : -x, lateral: sideways ? -x : 0 };
  };
  const down = (event) => {
    if (event.button !== 0) return;
    pad.current.setPointerCapture(event.pointerId);
    pointer.current = event.pointerId;
    pilot.hold("pad", share(event));
    event.preventDefault();
  };
  const move = (event) => {
    if (pilot.holder !== "pad" || event.pointerId !== pointer.current) return;
    if (event.buttons === 1) pilot.hold("pad", share(event));
    else pilot.end("taken");  // the release was lost, or another button may open a menu
  };
  const up = () => pilot.letGo("pad");
  useEffect(() => {
    // Not as onLostPointerCapture: Preact removes the "Capture", and never calls the listener.
    pad.current.addEventListener("lostpointercapture", up);
    return up;
  }, [pilot]);
  const { linear, angular, lateral } = pilot.share;
  const [x, y] = [100 - 78 * (sideways ? lateral : angular), 100 - 78 * linear];
  return html`<div class="pad ${pilot.held ? "held" : ""}" ref=${pad} role="img"
      aria-label=${TEXT.pad}
      onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up}
      onContextMenu=${(event) => event.preventDefault()}>
    <svg viewBox="0 0 200 200" aria-hidden="true">
      <circle class="rim" cx="100" cy="100" r="97" />
      <circle class="ring" cx="100" cy="100" r="48" />
      <path class="ring" d="M100 12v176M12 100h176" />
      <path class="mark"
        d="M100 10l7 11h-14zM100 190l7-11h-14zM10 100l11 7v-14zM190 100l-11 7v-14z" />
      <line class="stalk" x1="100" y1="100" x2=${x} y2=${y} />
      <circle class="knob" cx=${x} cy=${y} r="22" />
    </svg>
    ${!pilot.held && html`<span class="pad-hint">${TEXT.padHint}</span>`}
  </div>`;
}

/** Returns the notice for the user of the pad. */
function noticeOf(link, pilot) {
  if (!link.mayCommand) return TEXT.watching;
  const powered = ["armed", "moving", "stopping"].includes(link.now.state);
  if (pilot.held) return powered ? TEXT.driving : TEXT.armFirst;
  return (TEXT.releasedBy[pilot.released] ?? pilot.released) || TEXT.notDriving;
}

export function Drive({ link, pilot, trail }) {
  useLink(link, 60);
  const [sideways, setSideways] = useState(false);
  const lateral = (link.hello?.limits.lateral_m_s ?? 0) > 0;
  useKeys(pilot);
  const gamepad = useGamepad(pilot, lateral);
  if (!link.hello || !link.now) return html`<p class="muted">${TEXT.staleText}</p>`;
  if (!link.hello.wheels.length) {
    return html`<div class="column"><${StateCard} link=${link} />
      <${Card}><p>${TEXT.noBase}</p><//></div>`;
  }
  const { now } = link;
  const wanted = pilot.wanted;
  const limits = link.hello.limits;
  const twist = (linear, angular) =>
    `${measure(linear, 2, "m_s")}, ${measure(angular, 2, "rad_s")}`;
  const limit = (event) => {
    pilot.limiter = event.target.value / 100;
    link.version += 1;
  };
  return html`<div class="grid drive">
    <${Card} className="pad-card">
      <${Pad} pilot=${pilot} sideways=${sideways} />
      <p class="notice" role="status">
        ${noticeOf(link, pilot)}
      </p>
      <label class="slider"><span>${TEXT.limiter}</span>
        <input type="range" min="5" max="100" step="5" value=${Math.round(pilot.limiter * 100)}
          onInput=${limit} />
        <output>${Math.round(pilot.limiter * 100)} %:${" "}
          ${twist(pilot.limiter * limits.linear_m_s, pilot.limiter * limits.angular_rad_s)}
        </output></label>
      ${lateral && html`<label class="check"><input type="checkbox" checked=${sideways}
        onChange=${(event) => setSideways(event.target.checked)} /> ${TEXT.strafe}</label>`}
    <//>
    <div class="column">
      <${StateCard} link=${link} />
      <${Card}>
        <${Rows} rows=${[
          [TEXT.requested, twist(wanted.linear, wanted.angular)],
          [TEXT.setpoint, twist(now.setpoint_linear_m_s, now.setpoint_angular_rad_s)],
          [TEXT.measured, twist(now.linear_m_s, now.angular_rad_s)],
          [TEXT.commander, commander(link)],
          [TEXT.gamepad, gamepad || TEXT.gamepadNone],
        ]} />
        <p class="muted">${TEXT.keys}. ${TEXT.gamepadHint}</p>
        <p class="muted">${TEXT.deadMan}</p>
      <//>
    </div>
    <${Card} className="map"><${BaseView} link=${link} trail=${trail} /><//>
  </div>`;
}
