// SPDX-License-Identifier: Apache-2.0
// Limits as sliders: changed here, then applied all at once or not at all.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Difference, useCall, useLink } from "../parts/parts.js";

const STEPS = 400;
const SPAN = 20;  // from the lowest to the highest value of a slider

/** Returns the range of a slider. It is logarithmic: a limit may lie anywhere in five decades. It
 *  ends at the robot file's value: a higher one has to be typed. */
function range(about, value) {
  const known = [value, about.from_file].filter((one) => typeof one === "number");
  const top = known.length ? Math.max(...known) : 10 * SPAN;
  const high = Math.min(about.maximum ?? Infinity, top);
  return { low: Math.max(about.minimum, Math.min(high / SPAN, value ?? Infinity)), high };
}

const toStep = ({ low, high }, value) =>
  (high > low ? Math.round((STEPS * Math.log(value / low)) / Math.log(high / low)) : STEPS);
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
    <span class="muted small">${TEXT.most(about.minimum, about.maximum, unit)}; ${
      TEXT.fromFile(about.from_file ?? TEXT.noLimit)}${
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

/** Asks whether limits that the robot refuses are to be set all the same. */
function Confirm({ asked, apply, close }) {
  return html`<div class="difference" role="alertdialog" aria-label=${TEXT.force}>
    <p class="problem" role="alert">${TEXT.failed(TEXT.apply, asked.why)}</p>
    <ul>${Object.entries(asked.changes).map(([name, value]) =>
      html`<li><b>${name}</b>: ${value ?? TEXT.noLimit}</li>`)}</ul>
    <div class="actions">
      <button onClick=${close}>${TEXT.cancel}</button>
      <button class="danger" onClick=${() => apply({ ...asked.changes, force: true })}>
        ${TEXT.force}</button>
    </div>
  </div>`;
}

export function Parameters({ link }) {
  useLink(link, 500);
  const [listed, setListed] = useState({});
  const [edited, setEdited] = useState({});
  const [diff, setDiff] = useState(null);
  const [asked, ask] = useState(null);  // changes that need a confirmation, and why
  const [call, problem, say] = useCall(link);
  const open = link.phase === "open";
  const look = () => call("params.list", TEXT.limits).then((found) => found && setListed(found));
  useEffect(() => { if (open) look(); }, [open]);
  const inForce = link.status?.parameters ?? {};
  const rows = Object.entries(listed).filter(([name]) => name.startsWith("limits."))
    .map(([name, about]) => [name, name in inForce ? { ...about, value: inForce[name] } : about]);
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
  const edit = (next) => {
    ask(null);  // what was asked about is not what is shown any more
    setEdited(next);
  };
  const apply = async (wanted) => {
    ask(null);
    say("");
    try {
      const now = await link.call("params.set", wanted);
      setListed((before) => Object.fromEntries(Object.entries(before).map(([name, about]) =>
        [name, name in now ? { ...about, value: now[name] } : about])));
      setEdited({});
    } catch (error) {
      if (error.needsForce) ask({ why: error.message, changes: wanted });
      else say(TEXT.failed(TEXT.apply, error.message));
    }
  };
  return html`<${Card} title=${TEXT.limits} className="parameters" extra=${html`
      <span class="muted">${count ? TEXT.changed(count) : TEXT.unchanged}</span>
      <button disabled=${!count} onClick=${() => edit({})}>${TEXT.revert}</button>
      <button class="main" disabled=${!count || !link.mayCommand} onClick=${() => apply(changes)}>
        ${TEXT.apply}</button>
      <button disabled=${count || !link.mayCommand} onClick=${compare}>${TEXT.save}</button>`}>
    ${problem}
    ${asked && html`<${Confirm} asked=${asked} apply=${apply} close=${() => ask(null)} />`}
    ${diff && html`<${Saving} found=${diff} save=${save} close=${() => setDiff(null)} />`}
    ${rows.map(([name, about]) => html`<${Row} key=${name} name=${name} about=${about}
      inForce=${about.value}
      value=${name in edited ? edited[name] : about.value}
      change=${(key, value) => edit((before) => ({ ...before, [key]: value }))} />`)}
    <p class="muted">${TEXT.lasting}</p>
  <//>`;
}
