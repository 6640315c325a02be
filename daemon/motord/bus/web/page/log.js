// SPDX-License-Identifier: Apache-2.0
// What happened, and the recordings that are on the robot.

import { html, useEffect, useState } from "./vendor/htm-preact.js";
import { TEXT } from "./text.js";
import { Card, Choice, useCall, useLink } from "./parts.js";

const SHOWN_MAX = 300;
const WORTH = { all: ["info", "warning", "error"], warning: ["warning", "error"], error: ["error"] };

const clock = (seconds) => new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });
const moment = (seconds) => new Date(seconds * 1000).toLocaleString([], { hour12: false });

function Events({ link }) {
  const [filter, setFilter] = useState("");
  const [level, setLevel] = useState("all");
  const wanted = filter.toLowerCase();
  const rows = link.events.toSorted((one, other) => one.wall_time_s - other.wall_time_s)
    .filter((event) => WORTH[level].includes(event.level))
    .filter((event) => `${event.source} ${event.text}`.toLowerCase().includes(wanted))
    .slice(-SHOWN_MAX).reverse();
  return html`<${Card} title=${TEXT.events} extra=${html`
      <${Choice} label=${TEXT.filter} value=${level} options=${Object.entries(TEXT.levels)} onChange=${setLevel} />
      <input type="search" aria-label=${TEXT.filter} placeholder=${TEXT.filter} value=${filter}
        onInput=${(event) => setFilter(event.target.value)} />`}>
    ${rows.length === 0 && html`<p class="muted">${TEXT.noEvents}</p>`}
    <ol class="events" tabindex="0" aria-label=${TEXT.events}>${rows.map((event) => html`
      <li key=${event.number} class=${event.level}><time>${clock(event.wall_time_s)}</time>
        <b>${event.source}</b> <span>${event.text}</span></li>`)}</ol>
  <//>`;
}

function Recordings({ link }) {
  const [found, setFound] = useState([]);
  const [call, problem] = useCall(link);
  const open = link.phase === "open";
  const look = () => call("recordings", TEXT.recordings).then((rows) => rows && setFound(rows));
  useEffect(() => { if (open) look(); }, [open]);
  const download = async ({ section, name }) => {
    const address = await call("ticket", TEXT.download, { section, name });
    if (!address) return;
    const anchor = document.createElement("a");
    anchor.href = `${link.address}${address}`;
    anchor.download = name;
    anchor.click();
  };
  return html`<${Card} title=${TEXT.recordings} extra=${html`<button onClick=${look}>${TEXT.refresh}</button>`}>
    ${problem}
    ${found.length === 0 && html`<p class="muted">${TEXT.noRecordings}</p>`}
    <ul class="recordings">${found.map((row) => html`<li key=${row.name}>
      <span><b>${row.name}</b><br /><span class="muted">${moment(row.wall_time_s)}, ${TEXT.size(row.bytes)}</span></span>
      <button aria-label=${`${TEXT.download} ${row.name}`} onClick=${() => download(row)}>${TEXT.download}</button></li>`)}</ul>
  <//>`;
}

export function Log({ link }) {
  useLink(link, 300);
  return html`<div class="grid log"><${Events} link=${link} /><${Recordings} link=${link} /></div>`;
}
