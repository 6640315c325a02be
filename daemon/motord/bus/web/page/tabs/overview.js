// SPDX-License-Identifier: Apache-2.0
// The state in words, what to do next, the base from above, and every joint.

import { html } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Actions, Card, measure, number, Rows, useCall, useLink } from "../parts/parts.js";
import { BaseView } from "../parts/base_view.js";

/** Returns the reasons worth showing, without those that hold for every robot at rest. */
function telling(now) {
  const driven = ["moving", "stopping"].includes(now.state);
  const usual = now.state === "armed" ? ["command_stale"] : ["not_armed", "command_stale"];
  return driven ? now.reasons : now.reasons.filter((word) => !usual.includes(word));
}

/** Returns a warning while nobody sees whether the robot rests; empty: it is known. */
export function restProblem({ now, status, stale }) {
  if (stale || now?.rest !== "unknown") return "";
  return TEXT.restUnknown(Object.keys(status?.rest_unknown_s ?? {}));
}

export function StateCard({ link }) {
  const { now, status } = link;
  if (!now) return null;
  const waits = Object.values(status?.lines ?? {}).map((line) => line.waits_for).filter(Boolean);
  const why = now.faults.length ? status?.why ?? [] : [];
  const reasons = telling(now).map((word) => TEXT.reasons[word] ?? word);
  return html`<${Card} className="state state-${now.state}">
    <p class="state-word">${TEXT.states[now.state] ?? now.state}</p>
    <${Actions} link=${link} />
    <p class="next">${restProblem(link) || TEXT.next[now.state]}</p>
    ${link.stale && html`<p class="why">
      ${TEXT.lastState(TEXT.states[link.newest.state], link.staleS)}</p>`}
    ${now.faults.length > 0 && html`<p class="faults">
      ${now.faults.join(", ").replaceAll("_", " ")}</p>`}
    ${[...new Set([...why, ...waits])].map((text) => html`<p class="why">${text}</p>`)}
    ${status?.held?.length > 0 && html`<p class="why">
      ${TEXT.held(status.held.map((one) => one.owner).join(", "))}</p>`}
    ${reasons.length > 0 && html`<p class="muted">${TEXT.limited}: ${reasons.join(", ")}</p>`}
  <//>`;
}

export function commander(link) {
  if (!link.status) return TEXT.notKnown;
  const first = link.status?.leases?.find((lease) => lease.number === link.now?.owner);
  if (!first) return TEXT.noCommander;
  const driver = link.status.driver;
  return driver ? `${first.owner} (${TEXT.drivenBy(driver)})` : first.owner;
}

export function battery(link) {
  if (!link.status) return TEXT.notKnown;
  const found = link.status.battery;
  const volts = link.now?.joints.map((joint) => joint.voltage_v).filter(Number.isFinite) ?? [];
  if (!found) return volts.length ? measure(Math.min(...volts), 1, "v") : TEXT.batteryUnknown;
  const current = found.current_a !== null && measure(found.current_a, 1, "a");
  return [found.state, measure(found.voltage_v, 1, "v"), current].filter(Boolean).join(", ");
}

/** Returns since when it is not known what these joints measure; a dash without a state. */
function unknownSince(link, joints) {
  if (link.stale) return "–";
  if (!joints.length) return TEXT.notKnown;
  return TEXT.notKnownSince(Math.max(...joints.map((joint) => joint.feedback_age_s)));
}

function Motion({ link }) {
  const { now, hello } = link;
  const [call, problem] = useCall(link);
  const pair = (measured, setpoint, unit) => html`${Number.isFinite(now[measured])
    ? measure(now[measured], 2, unit) : unknownSince(link, now.joints.filter(({ stale }) => stale))}
    <span class="muted">/ ${number(now[setpoint])}</span>`;
  const based = hello.wheels.length > 0;
  const rows = [
    based && [`${TEXT.speed} / ${TEXT.setpoint}`, pair("linear_m_s", "setpoint_linear_m_s", "m_s")],
    based && hello.limits.lateral_m_s > 0 &&
      [`${TEXT.lateral} / ${TEXT.setpoint}`, pair("lateral_m_s", "setpoint_lateral_m_s", "m_s")],
    based &&
      [`${TEXT.turn} / ${TEXT.setpoint}`, pair("angular_rad_s", "setpoint_angular_rad_s", "rad_s")],
    based && [TEXT.pose, `x ${measure(now.x_m, 2, "m")}, y ${measure(now.y_m, 2, "m")}`],
    based && [TEXT.heading, `${number((now.heading_rad * 180) / Math.PI, 0)}°`],
    based && [TEXT.distance, measure(now.distance_m, 2, "m")],
    [TEXT.commander, commander(link)],
    [TEXT.battery, battery(link)],
    [TEXT.pages, link.status?.pages ?? "–"],
  ].filter(Boolean);
  return html`<${Card}>
    <${Rows} rows=${rows} />
    ${based && html`<div class="actions"><button disabled=${!link.mayCommand}
      onClick=${() => call("reset_odometry", TEXT.resetOdometry)}>
      ${TEXT.resetOdometry}</button></div>`}
    ${problem}
  <//>`;
}


function Joints({ link }) {
  const { hello, now, status } = link;
  return html`<${Card} title=${TEXT.joints} className="wide">
    <div class="table" tabindex="0" role="region" aria-label=${TEXT.joints}><table>
      <thead><tr><th scope="col">${TEXT.joint}</th><th scope="col">${TEXT.drive}</th>
        <th scope="col" class="num">${TEXT.setpoint}</th>
        <th scope="col" class="num">${TEXT.speed}</th>
        <th scope="col" class="num">${TEXT.position}</th>
        <th scope="col" class="num">${TEXT.current}</th>
        <th scope="col" class="num">${TEXT.voltage}</th>
        <th scope="col" class="num">${TEXT.temperature}</th>
        <th scope="col" class="num">${TEXT.age}</th></tr></thead>
      <tbody>${hello.joints.map((name, place) => {
        const joint = now.joints[place];
        const known = status?.joints[name];
        return html`<tr class=${joint.stale ? "bad" : ""}>
          <th scope="row">${name}</th>
          <td>${known?.drive ?? "–"} ${known?.fault_words.join(", ")}</td>
          <td class="num">${measure(joint.setpoint_rad_s, 2, "rad_s")}</td>
          <td class="num">${measure(joint.velocity_rad_s, 2, "rad_s")}</td>
          <td class="num position">${measure(joint.position_rad, 2, "rad")}</td>
          <td class="num">${measure(joint.current_a, 2, "a")}</td>
          <td class="num">${measure(joint.voltage_v, 1, "v")}</td>
          <td class="num">${measure(joint.temperature_c, 0, "c")}</td>
          <td class="num">${joint.stale ? unknownSince(link, [joint])
            : `${number(joint.feedback_age_s * 1000, 0)} ms`}</td>
        </tr>`;
      })}</tbody>
    </table></div>
  <//>`;
}

/** Shows the angle of each joint: zero is to the right, and positive angles turn to the left. */
function Dials({ link }) {
  const { hello, now } = link;
  return html`<${Card} className="dials">${hello.joints.map((name, place) => {
    const { position_rad, stale } = now.joints[place];
    const degrees = (position_rad * 180) / Math.PI;
    const known = Number.isFinite(degrees);
    return html`<figure class="dial ${stale ? "bad" : ""}">
      <svg viewBox="-55 -55 110 110" aria-hidden="true">
        <circle r="50" /><path class="zero" d="M42 0H50" />
        ${known && html`<path class="needle" d="M0 0H40" transform="rotate(${-degrees})" />`}
      </svg>
      <figcaption><b>${name}</b> ${known ? `${number(degrees, 0)}°` : "–"}</figcaption>
    </figure>`;
  })}<//>`;
}

export function Overview({ link, trail }) {
  useLink(link);
  if (!link.hello || !link.now) return html`<p class="muted">${TEXT.noState}</p>`;
  return html`<div class="grid overview">
    <div class="column"><${StateCard} link=${link} /><${Motion} link=${link} /></div>
    ${link.hello.wheels.length > 0
      ? html`<${Card} className="map"><${BaseView} link=${link} trail=${trail} /><//>`
      : html`<${Dials} link=${link} />`}
    <${Joints} link=${link} />
  </div>`;
}
