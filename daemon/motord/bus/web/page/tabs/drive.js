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
const MIDDLE = 0.25;  // radius of the part of the pad where a hold begins, which requests rest
const REST_MS = 150;  // a finger that leaves the middle sooner swipes, as one that scrolls does
const PAD_MIDDLE = { inset: `${50 - 50 * MIDDLE}%` };

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

/** Returns how far a point is from the middle of the pad, in parts of its radius. */
function offset(box, event) {
  const radius = box.width / 2;
  return [(event.clientX - box.left) / radius - 1, (event.clientY - box.top) / radius - 1];
}

/** Returns the parts of the limits that a point requests: nothing in the middle, and from its edge
 *  on more, up to everything at the rim. */
function shareOf([x, y], sideways) {
  const length = Math.hypot(x, y);
  const part = Math.min(1, Math.max(0, (length - MIDDLE) / (1 - MIDDLE)));
  const [ahead, left] = part ? [-y * part / length, -x * part / length] : [0, 0];
  return { linear: ahead, angular: sideways ? 0 : left, lateral: sideways ? left : 0 };
}

function Pad({ pilot, sideways }) {
  const pad = useRef(null);
  const press = useRef(null);  // the pointer that holds the pad, and the pad's box at its press
  const down = (event) => {
    if (event.button !== 0 || pilot.held) return;  // another finger commands nothing
    const box = pad.current.getBoundingClientRect();
    if (Math.hypot(...offset(box, event)) > MIDDLE) {
      pilot.refuse("outside");
      return;
    }
    const { pointerId: id, timeStamp: atMs, pointerType } = event;
    press.current = { id, box, atMs, rested: pointerType === "mouse" };
    pad.current.setPointerCapture(id);
    pilot.hold("pad", REST);
    event.preventDefault();
  };
  const move = (event) => {
    const held = press.current;
    if (pilot.holder !== "pad" || event.pointerId !== held?.id) return;
    if (event.buttons !== 1) {
      pilot.end("taken");  // the release was lost, or another button may open a menu
      return;
    }
    const share = shareOf(offset(held.box, event), sideways);
    held.rested ||= event.timeStamp - held.atMs >= REST_MS;
    if (held.rested) pilot.hold("pad", share);
    else if (share.linear || share.angular || share.lateral) pilot.end("swiped");
  };
  const up = (event) => {
    if (event.pointerId === press.current?.id) pilot.letGo("pad");
  };
  useEffect(() => {
    // Not as onLostPointerCapture: Preact removes the "Capture", and never calls the listener.
    pad.current.addEventListener("lostpointercapture", up);
    return () => pilot.letGo("pad");
  }, [pilot]);
  const { linear, angular, lateral } = pilot.share;
  const left = sideways ? lateral : angular;
  const length = Math.hypot(left, linear);
  const reach = length ? 78 * (MIDDLE + (1 - MIDDLE) * length) / length : 0;
  const [x, y] = [100 - reach * left, 100 - reach * linear];
  return html`<div class="pad ${pilot.held ? "held" : ""}" ref=${pad} role="img"
      aria-label=${TEXT.pad}
      onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up}
      onContextMenu=${(event) => event.preventDefault()}>
    <svg viewBox="0 0 200 200" aria-hidden="true">
      <circle class="rim" cx="100" cy="100" r="97" />
      <circle class="middle" cx="100" cy="100" r=${100 * MIDDLE} />
      <path class="ring" d="M100 12v176M12 100h176" />
      <path class="mark"
        d="M100 10l7 11h-14zM100 190l7-11h-14zM10 100l11 7v-14zM190 100l-11 7v-14z" />
      <line class="stalk" x1="100" y1="100" x2=${x} y2=${y} />
      <circle class="knob" cx=${x} cy=${y} r="22" />
    </svg>
    <i class="pad-middle" style=${PAD_MIDDLE}></i>
    ${!pilot.held && html`<span class="pad-hint">${TEXT.padHint}</span>`}
  </div>`;
}

/** Returns the notice for the user of the pad. */
function noticeOf(link, pilot) {
  if (link.stale) return TEXT.noState;
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
  if (!link.hello || !link.now) return html`<p class="muted">${TEXT.noState}</p>`;
  if (!link.hello.wheels.length) {
    return html`<div class="column"><${StateCard} link=${link} />
      <${Card}><p>${TEXT.noBase}</p><//></div>`;
  }
  const { now } = link;
  const wanted = pilot.wanted;
  const limits = link.limits;
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
          ${twist(pilot.limiter * limits?.linear_m_s, pilot.limiter * limits?.angular_rad_s)}
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
