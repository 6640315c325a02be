// SPDX-License-Identifier: Apache-2.0
// Recordings: started, stopped, listed, downloaded, and run through the core again.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, number, useCall } from "../parts/parts.js";

const LOOK_EVERY_MS = 2000;
const NOTHING = { recorders: [], files: [] };

const moment = (seconds) => new Date(seconds * 1000).toLocaleString([], { hour12: false });

function Recorder({ recorder, link, change }) {
  const { section, mode, recording, file, failing } = recorder;
  const works = recording ? TEXT.recorderModes[mode] : TEXT.recorderWaits;
  const [method, title] =
    recording ? ["record.stop", TEXT.recordStop] : ["record.start", TEXT.recordStart];
  return html`<div class="recorder">
    <span><b>${section}</b> <span class="chip ${recording ? "recording" : ""}">
      ${failing ? TEXT.recorderFailing : works}</span>
      ${file && html`<br /><span class="muted">${file}</span>`}</span>
    ${mode === "manual" && html`
      <button class=${recording ? "" : "main"} disabled=${!link.permitted}
        onClick=${() => change(method, title, { section })}>${title}</button>`}
  </div>`;
}

/** Shows what a replay has found: the ticks that differ, field by field. */
function Outcome({ outcome, joints }) {
  const { ticks, seconds, checkpoints, gaps, skipped, differences } = outcome;
  const whole = TEXT.replayed(ticks, number(seconds, 1), checkpoints, gaps, skipped);
  if (outcome.identical) {
    return html`<p class="good">${TEXT.identical} <span class="muted">${whole}</span></p>`;
  }
  const named = (field) => field.replace(/joint\[(\d+)\]/, (all, place) => joints[place] ?? all);
  const value = (found) => (found === null ? "–" : String(found));
  const rows = differences.flatMap(({ tick, time_s, fields }) =>
    fields.map((field) => ({ tick, time_s, ...field })));
  return html`<p class="problem" role="status">${TEXT.differing(outcome.differing_ticks)}${" "}
      <span class="muted">${whole}</span></p>
    <div class="table differences" tabindex="0" role="region" aria-label=${TEXT.differences}><table>
      <thead><tr><th scope="col" class="num">${TEXT.tick}</th>
        <th scope="col" class="num">${TEXT.time}</th>
        <th scope="col">${TEXT.field}</th><th scope="col" class="num">${TEXT.recorded}</th>
        <th scope="col" class="num">${TEXT.replayedNow}</th></tr></thead>
      <tbody>${rows.map((row) => html`<tr><td class="num">${row.tick}</td>
        <td class="num">${number(row.time_s, 3)} s</td><td>${named(row.field)}</td>
        <td class="num">${value(row.recorded)}</td>
        <td class="num">${value(row.replayed)}</td></tr>`)}
      </tbody></table></div>`;
}

function File({ row, link, change, download }) {
  const { section, name, replay } = row;
  const running = Boolean(replay?.state);
  const title = running ? TEXT.cancel : TEXT.replay;
  const writing = row.writing ? `, ${TEXT.writing}` : "";
  const turn = () => change(running ? "replay.cancel" : "replay", TEXT.replay, { section, name });
  return html`<li>
    <div class="file"><span><b>${name}</b><br />
      <span class="muted">${moment(row.wall_time_s)}, ${TEXT.size(row.bytes)}${writing}</span>
    </span>
      <span class="actions">
        <button disabled=${!link.permitted || row.writing} aria-label=${`${title} ${name}`}
          onClick=${turn}>${title}</button>
        <button aria-label=${`${TEXT.download} ${name}`} onClick=${() => download(row)}>
          ${TEXT.download}</button>
      </span></div>
    ${running && html`<p class="muted" role="status">${TEXT.replayStates[replay.state]}</p>`}
    ${replay?.problem && html`<p class="problem">${TEXT.failed(TEXT.replay, replay.problem)}</p>`}
    ${replay?.outcome && html`
      <${Outcome} outcome=${replay.outcome} joints=${link.hello?.joints ?? []} />`}
  </li>`;
}

export function Recordings({ link }) {
  const [found, setFound] = useState(NOTHING);
  const [call, problem] = useCall(link);
  const open = link.phase === "open";
  // An error means that there is no connection, which the page shows.
  const look = () => link.call("recordings").then(setFound, () => {});
  useEffect(() => {
    if (!open) return undefined;
    look();
    const timer = setInterval(() => document.hidden || look(), LOOK_EVERY_MS);
    const end = link.on("recordings", look);
    return () => {
      clearInterval(timer);
      end();
    };
  }, [open]);
  const change = (method, title, params) => call(method, title, params);
  const download = async ({ section, name }) => {
    const address = await call("ticket", TEXT.download, { section, name });
    if (!address) return;
    const anchor = document.createElement("a");
    anchor.href = `${link.address}${address}`;
    anchor.download = name;
    anchor.click();
  };
  const { recorders, files } = found;
  return html`<${Card} title=${TEXT.recordings}>
    ${problem}
    ${recorders.map((one) => html`
      <${Recorder} key=${one.section} recorder=${one} link=${link} change=${change} />`)}
    ${recorders.length === 0 ? html`<p class="muted">${TEXT.noRecorders}</p>`
      : files.length === 0 && html`<p class="muted">${TEXT.noRecordings}</p>`}
    <ul class="recordings">${files.map((row) => html`
      <${File} key=${`${row.section} ${row.name}`} row=${row} link=${link}
      change=${change} download=${download} />`)}</ul>
    ${files.length > 0 && html`<p class="muted">${TEXT.replayHelp}</p>`}
  <//>`;
}
