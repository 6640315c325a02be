// SPDX-License-Identifier: Apache-2.0
// A gamepad drives while its dead-man button is held: w3c.github.io/gamepad.

import { useEffect, useState } from "../vendor/htm-preact.js";

const LOOK_EVERY_MS = 40;
const DEAD_ZONE = 0.12;
const DEAD_MAN_BUTTON = 4;  // left shoulder of the standard gamepad

const zone = (value) => {
  if (!(Math.abs(value) > DEAD_ZONE)) return 0;  // also for NaN and an axis that is missing
  return (value - Math.sign(value) * DEAD_ZONE) / (1 - DEAD_ZONE);
};

/** Returns the name of the gamepad; empty: no gamepad is connected. */
export function useGamepad(pilot, lateral) {
  const [name, setName] = useState("");
  useEffect(() => {
    let ready = null;    // the pad whose button was released before: only this one may begin a hold
    let holding = null;
    const look = () => {
      const found = [...navigator.getGamepads()].find((pad) => pad?.connected);
      setName(found?.id ?? "");
      const pad = found ? `${found.index} ${found.id}` : null;
      const held = Boolean(found?.buttons[DEAD_MAN_BUTTON]?.pressed);
      const goesOn = held && pilot.holder === "gamepad" && pad === holding;
      const mayBegin = held && pilot.holder === null && pad === ready && document.hasFocus();
      const begins = mayBegin && found.axes.slice(0, 3).every((axis) => zone(axis) === 0);
      ready = held && (begins || !mayBegin) ? null : pad;
      if (!goesOn && !begins) {
        pilot.letGo("gamepad");
        return;
      }
      holding = pad;
      const [x, y, second] = found.axes;
      pilot.hold("gamepad", {
        linear: -zone(y), angular: -zone(lateral ? second : x), lateral: lateral ? -zone(x) : 0,
      });
    };
    const timer = setInterval(look, LOOK_EVERY_MS);
    return () => {
      clearInterval(timer);
      pilot.letGo("gamepad");
    };
  }, [pilot, lateral]);
  return name;
}
