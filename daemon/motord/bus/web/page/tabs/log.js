// SPDX-License-Identifier: Apache-2.0
// What happened, and the recordings that are on the robot.

import { html, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Choice, useLink } from "../parts/parts.js";
import { Recordings } from "./recordings.js";

const SHOWN_MAX = 300;
const WORTH = {
  all: ["info", "warning", "error"], warning: ["warning", "error"], error: ["error"],
};

const clock = (seconds) => new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });

function Events({ link }) {
  const [filter, setFilter] = useState("");
  const [level, setLevel] = useState("all");
  const wanted = filter.toLowerCase();
  const rows = link.events.toSorted((one, other) => one.wall_time_s - other.wall_time_s)
    .filter((event) => WORTH[level].includes(event.level))
    .filter((event) => `${event.source} ${event.text}`.toLowerCase().includes(wanted))
    .slice(-SHOWN_MAX).reverse();
  return html`<${Card} title=${TEXT.events} extra=${html`
      <${Choice} label=${TEXT.filter} value=${level} options=${Object.entries(TEXT.levels)}
        onChange=${setLevel} />
      <input type="search" aria-label=${TEXT.filter} placeholder=${TEXT.filter} value=${filter}
        onInput=${(event) => setFilter(event.target.value)} />`}>
    ${rows.length === 0 && html`<p class="muted">${TEXT.noEvents}</p>`}
    <ol class="events" tabindex="0" aria-label=${TEXT.events}>${rows.map((event) => html`
      <li key=${event.number} class=${event.level}><time>${clock(event.wall_time_s)}</time>
        <b>${event.source}</b> <span>${event.text}</span></li>`)}</ol>
  <//>`;
}

export function Log({ link }) {
  useLink(link, 300);
  return html`<div class="grid log"><${Events} link=${link} /><${Recordings} link=${link} /></div>`;
}
