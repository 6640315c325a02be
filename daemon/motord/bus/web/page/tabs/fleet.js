// SPDX-License-Identifier: Apache-2.0
// Several robots, each with its state and its emergency stop.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { ESTOP_WITHIN_MS, Link } from "../link.js";
import { Card, measure, Rows, useCall, useLink } from "../parts/parts.js";
import { battery, commander } from "./overview.js";

const RATE_HZ = 2;

let pressed = 0;
let missed = [];  // by the newest e-stop for all: robot and reason; kept when the page changes

async function estop(one) {
  if (one.phase === "refused") throw new Error(TEXT.needsToken);
  if (one.phase !== "open") throw new Error(TEXT.notConnected);
  if (!one.mayCommand && one.hello.takes_commands) throw new Error(TEXT.needsToken);
  await one.call("estop", {}, ESTOP_WITHIN_MS);
}

/** Stops all robots. `changed` is called at once for each robot that was not reached. */
function estopAll(links, changed) {
  const press = (pressed += 1);
  missed = [];
  links.forEach((one) => estop(one).catch((error) => {
    if (press !== pressed) return;
    const name = `${one.hello?.robot ?? TEXT.robot} (${one.address})`;
    missed = [...missed, TEXT.failed(name, error.message)];
    changed();
  }));
  changed();
}

function Robot({ link, own }) {
  useLink(link);
  const [call, problem] = useCall(link);
  const [token, setToken] = useState("");
  const state = link.phase !== "open" || link.stale ? "unknown" : link.now?.state ?? "unknown";
  const name = link.hello?.robot ?? link.address;
  const { now } = link;
  const watches = link.phase === "open" && !link.mayCommand && link.hello.takes_commands;
  const connect = (event) => {
    event.preventDefault();
    link.setToken(token.trim() || null);
  };
  return html`<${Card} title=${name} className="robot"
      extra=${html`<span class="chip state-${state}">${TEXT.states[state]}</span>`}>
    <p class="muted">${own ? TEXT.thisRobot : html`<a href=${link.address}>${link.address}</a>`}</p>
    ${link.phase === "lost" && html`<p class="why">${TEXT.lost}</p>`}
    ${link.phase === "refused" || watches ? html`
      <form onSubmit=${connect}>
        ${link.why && html`<p class="problem" role="alert">${link.why}</p>`}
        <label><span>${TEXT.tokenFor(name)}</span>
          <input type="password" value=${token}
            onInput=${(event) => setToken(event.target.value)} /></label>
        <button type="submit">${TEXT.tokenSend}</button></form>` : null}
    ${now && html`<${Rows} rows=${[
      [TEXT.speed,
        `${measure(now.linear_m_s, 2, "m_s")}, ${measure(now.angular_rad_s, 2, "rad_s")}`],
      [TEXT.commander, commander(link)], [TEXT.battery, battery(link)],
    ]} />`}
    ${now?.faults.length > 0 && html`<p class="faults">
      ${now.faults.join(", ").replaceAll("_", " ")}</p>`}
    <button class="estop" disabled=${!link.mayCommand}
      onClick=${() => call("estop", TEXT.estop, {}, ESTOP_WITHIN_MS)}>${TEXT.estop}</button>
    ${problem}
  <//>`;
}

export function Fleet({ link }) {
  useLink(link);
  const fleet = link.hello?.fleet ?? [];
  const addresses = fleet.join(" ");
  const [others, setOthers] = useState([]);
  useEffect(() => {
    const made = fleet.filter((address) => address !== link.address)
      .map((address) => new Link(address, RATE_HZ));
    setOthers(made);
    return () => made.forEach((one) => one.end());
  }, [addresses]);
  const links = [link, ...others];
  const all = () => estopAll(links, () => { link.version += 1; });
  return html`<div>
    <div class="toolbar"><p class="muted">${TEXT.fleetHelp}</p>
      ${others.length > 0 && html`<button class="estop" onClick=${all}>${TEXT.estopAll}</button>`}
      <div class="problem missed" role="alert">${missed.length > 0 && html`<p>${TEXT.notReached}</p>
        <ul>${missed.map((text) => html`<li>${text}</li>`)}</ul>`}</div></div>
    <div class="grid robots">${links.map((one) =>
      html`<${Robot} key=${one.address} link=${one} own=${one === link} />`)}</div>
  </div>`;
}
