// SPDX-License-Identifier: Apache-2.0
// Limits as sliders: changed here, then applied all at once or not at all.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Difference, useCall, useLink } from "../parts/parts.js";

const STEPS = 400;
const SPAN = 20;  // a slider goes from 1/20 of the value in force to 20 times that value

/** Returns the range of a slider. It is logarithmic: a limit may lie anywhere in five decades. */
function range(about, value) {
  const centre = value ?? 10;
  const low = Math.max(about.minimum, centre / SPAN);
  const high = Math.min(about.maximum ?? Infinity, centre * SPAN);
  return { low, high };
}

const toStep = ({ low, high }, value) =>
  Math.round((STEPS * Math.log(value / low)) / Math.log(high / low));
const toValue = ({ low, high }, step) =>
  Number((low * (high / low) ** (step / STEPS)).toPrecision(3));

function Row({ name, about, inForce, value, change }) {
  const [draft, setDraft] = useState(null);  // text being typed, which is no number yet
  const span = range(about, inForce);
  const noLimit = value === null;
  const title = name.split(".")[1];
  const changed = value !== inForce;
  const unit = about.unit;
  const type = (event) => {
    setDraft(event.target.value);
    const typed = Number(event.target.value.replace(",", "."));
    if (Number.isFinite(typed) && event.target.value.trim() !== "") change(name, typed);
  };
  const limit = (event) => change(name, event.target.checked ? null : inForce ?? 10);
  return html`<div class="parameter ${changed ? "changed" : ""}">
    <div class="name"><label for=${name}>${title}</label>
      <span class="muted">${about.description}</span></div>
    <input id=${name} type="range" min="0" max=${STEPS} disabled=${noLimit}
      value=${noLimit ? STEPS : toStep(span, value)}
      aria-valuetext=${noLimit ? TEXT.noLimit : `${value} ${unit}`}
      onInput=${(event) => change(name, toValue(span, Number(event.target.value)))} />
    <span class="entry"><input inputmode="decimal" size="7" aria-label=${`${title}, ${unit}`}
      disabled=${noLimit} value=${draft ?? (noLimit ? "" : value)}
      onBlur=${() => setDraft(null)} onInput=${type} /> ${unit}</span>
    ${about.maximum === null && html`<label class="check"><input type="checkbox" checked=${noLimit}
      onChange=${limit} /> ${TEXT.noLimit}</label>`}
    <span class="muted small">${about.minimum} … ${about.maximum ?? "∞"} ${unit}${
      changed ? `; ${TEXT.forceNow}: ${inForce ?? TEXT.noLimit}` : ""}</span>
  </div>`;
}

function Saving({ found, save, close }) {
  const written = found.backup !== null;  // the old file, kept beside it
  const wouldSave = found.diff ? TEXT.wouldSave(found.file) : TEXT.nothingToSave(found.file);
  return html`<div class="difference" role="region" aria-label=${TEXT.difference}>
    <p>${written ? TEXT.saved(found.file) : wouldSave}</p>
    ${found.diff && html`<${Difference} text=${found.diff} />`}
    <div class="actions">
      ${found.diff && !written && html`<button class="main" onClick=${save}>${TEXT.write}</button>`}
      <button onClick=${close}>${written || !found.diff ? TEXT.close : TEXT.cancel}</button>
    </div>
  </div>`;
}

export function Parameters({ link }) {
  useLink(link, 500);
  const [listed, setListed] = useState({});
  const [edited, setEdited] = useState({});
  const [diff, setDiff] = useState(null);
  const [call, problem] = useCall(link);
  const open = link.phase === "open";
  const look = () => call("params.list", TEXT.limits).then((found) => found && setListed(found));
  useEffect(() => { if (open) look(); }, [open]);
  const rows = Object.entries(listed).filter(([name]) => name.startsWith("limits."));
  const changes = Object.fromEntries(rows
    .filter(([name, about]) => name in edited && edited[name] !== about.value)
    .map(([name]) => [name, edited[name]]));
  const count = Object.keys(changes).length;
  const compare = async () => {
    const found = await call("params.diff", TEXT.save);
    if (found) setDiff(found);
  };
  const save = async () => {
    const found = await call("params.save", TEXT.save);
    if (found) setDiff(found);
  };
  const apply = async () => {
    const inForce = await call("params.set", TEXT.apply, changes);
    if (!inForce) return;
    setListed((before) => Object.fromEntries(Object.entries(before).map(([name, about]) =>
      [name, name in inForce ? { ...about, value: inForce[name] } : about])));
    setEdited({});
  };
  return html`<${Card} title=${TEXT.limits} className="parameters" extra=${html`
      <span class="muted">${count ? TEXT.changed(count) : TEXT.unchanged}</span>
      <button disabled=${!count} onClick=${() => setEdited({})}>${TEXT.revert}</button>
      <button class="main" disabled=${!count || !link.mayCommand} onClick=${apply}>
        ${TEXT.apply}</button>
      <button disabled=${count || !link.mayCommand} onClick=${compare}>${TEXT.save}</button>`}>
    ${problem}
    ${diff && html`<${Saving} found=${diff} save=${save} close=${() => setDiff(null)} />`}
    ${rows.map(([name, about]) => html`<${Row} key=${name} name=${name} about=${about}
      inForce=${about.value}
      value=${name in edited ? edited[name] : about.value}
      change=${(key, value) => setEdited((before) => ({ ...before, [key]: value }))} />`)}
    <p class="muted">${TEXT.lasting}</p>
  <//>`;
}
