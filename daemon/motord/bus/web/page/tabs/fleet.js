// SPDX-License-Identifier: Apache-2.0
// Several robots, each with its state and its emergency stop.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Link } from "../link.js";
import { Card, measure, Rows, useLink } from "../parts/parts.js";
import { battery, commander } from "./overview.js";

const RATE_HZ = 2;

let pressed = 0;
let missed = new Map();  // robots that the newest e-stop for all has not reached, and why

/** `report` gets why the robot is not reached yet, and nothing once it is. */
function estop(one, report) {
  const watches = one.phase === "open" && !one.permitted && one.hello.takes_commands;
  if (one.phase === "refused" || watches) return report(TEXT.needsToken);
  return one.estop((why) => report(why && one.phase !== "open" ? TEXT.notConnected : why));
}

/** Stops all robots. `changed` is called at once for each robot that was not reached. */
function estopAll(links, changed) {
  const press = (pressed += 1);
  missed = new Map();
  links.forEach((one) => estop(one, (why) => {
    if (press !== pressed) return;
    const name = `${one.hello?.robot ?? TEXT.robot} (${one.address})`;
    if (why) missed.set(one.address, TEXT.failed(name, why));
    else missed.delete(one.address);
    changed();
  }));
  changed();
}

function Robot({ link, own }) {
  useLink(link);
  const [doubt, setDoubt] = useState("");
  const [token, setToken] = useState("");
  const state = link.now?.state ?? "unknown";
  const name = link.hello?.robot ?? link.address;
  const { now } = link;
  const watches = link.phase === "open" && !link.permitted && link.hello.takes_commands;
  const connect = (event) => {
    event.preventDefault();
    link.setToken(token.trim() || null);
  };
  return html`<${Card} title=${name} className="robot"
      extra=${html`<span class="chip state-${state}">${TEXT.states[state]}</span>`}>
    <button class="estop" disabled=${!link.mayEstop}
      onClick=${() => link.estop(setDoubt)}>${TEXT.estop}
      ${link.mayEstop && link.stale && html`<small>${TEXT.estopUnsure}</small>`}</button>
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
    <p class="problem" role="alert">${doubt && TEXT.estopDoubt(doubt)}</p>
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
      <div class="problem missed" role="alert">${missed.size > 0 && html`<p>${TEXT.notReached}</p>
        <ul>${[...missed.values()].map((text) => html`<li>${text}</li>`)}</ul>`}</div></div>
    <div class="grid robots">${links.map((one) =>
      html`<${Robot} key=${one.address} link=${one} own=${one === link} />`)}</div>
  </div>`;
}
