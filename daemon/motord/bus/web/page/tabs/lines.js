// SPDX-License-Identifier: Apache-2.0
// The lines, what goes wrong on them, and the registers of the drives.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, number, Rows, useCall, useLink } from "../parts/parts.js";
import { Trace } from "./trace.js";

const AT_ONCE = 6;

function Errors({ errors, exchanges }) {
  const found = Object.entries(errors).filter(([, count]) => count > 0);
  if (!found.length) return html`<p class="good">${TEXT.noErrors}</p>`;
  const percent = (count) => number((100 * count) / Math.max(1, exchanges), 3);
  return html`<ul class="errors">${found.map(([kind, count]) => html`<li>
    <b>${count} ${kind}</b> <span class="muted">(${percent(count)} %)</span>
    <br />${TEXT.errorKinds[kind] ?? TEXT.errorKinds.other}</li>`)}</ul>`;
}

function Line({ name, line }) {
  const { p50, p99, max } = line.round_trip_us;
  const ms = (us, digits) => `${number(us / 1000, digits)} ms`;
  const share = Math.min(1, line.cycle_hz / line.requested_hz);
  const rows = [
    [TEXT.port, line.port],
    [TEXT.engine, line.engine],
    [TEXT.cycle, TEXT.ofRequested(number(line.cycle_hz, 0), number(line.requested_hz, 0))],
    [TEXT.roundTrip, `p50 ${ms(p50, 2)}, p99 ${ms(p99, 2)}, max ${ms(max, 1)}`],
    [TEXT.exchanges, line.exchanges],
  ];
  return html`<${Card} title=${`${TEXT.line} ${name}`}
      extra=${html`<span class="chip">${line.state}</span>`}>
    ${line.waits_for && html`<p class="why">${line.waits_for}</p>`}
    <${Rows} rows=${rows} />
    <meter min="0" max="1" value=${Number.isFinite(share) ? share : 0}
      aria-label=${TEXT.cycle}></meter>
    ${line.reopened > 0 && html`<p>${TEXT.reopened(line.reopened)}</p>`}
    <${Errors} errors=${line.errors} exchanges=${line.exchanges} />
  <//>`;
}

function Registers({ link, joint, rows }) {
  const [values, setValues] = useState({});
  const [typed, setTyped] = useState({});
  const [call, problem] = useCall(link);
  const read = async (names) => {
    for (let at = 0; at < names.length; at += AT_ONCE) {
      const found = await call("params.get", TEXT.read, { names: names.slice(at, at + AT_ONCE) });
      if (!found) return;
      setValues((before) => ({ ...before, ...found }));
    }
  };
  const write = async (name) => {
    const found = await call("params.set", TEXT.write, { [name]: Number(typed[name]) });
    if (!found) return;
    setValues((before) => ({ ...before, ...found }));
    setTyped(({ [name]: _, ...others }) => others);
  };
  const short = (value) => (value === null ? "–" : Number(value.toPrecision(6)));
  const span = ({ minimum, maximum }) =>
    minimum === null && maximum === null ? "" : `${short(minimum)} … ${short(maximum)}`;
  const disarmed = link.now?.state === "idle";
  const names = rows.map(([name]) => name);
  return html`<${Card} className="wide"
      title=${`${TEXT.registers}: ${joint} (${link.hello.drives[joint]})`}
      extra=${html`<button disabled=${!link.mayCommand} onClick=${() => read(names)}>
        ${TEXT.readAll}</button>`}>
    <div class="table" tabindex="0" role="region" aria-label=${`${TEXT.registers} ${joint}`}><table>
      <thead><tr><th scope="col">${TEXT.register}</th><th scope="col" class="num">${TEXT.value}</th>
        <th scope="col">${TEXT.unit}</th><th scope="col">${TEXT.range}</th><td></td>
        <th scope="col">${TEXT.source}</th></tr></thead>
      <tbody>${rows.map(([name, about]) => {
        const register = name.split(".").slice(2).join(".");
        const value = values[name];
        const settable = disarmed && link.mayCommand;
        const complete = Boolean(typed[name]) && Number.isFinite(Number(typed[name]));
        return html`<tr key=${name}>
          <th scope="row">${register}</th>
          <td class="num">${short(value ?? null)}</td>
          <td>${about.unit === "1" ? "" : about.unit}</td><td>${span(about)}</td>
          <td class="edit">
            <button disabled=${!link.mayCommand} onClick=${() => read([name])}
              aria-label=${`${TEXT.read} ${register}`}>${TEXT.read}</button>
            ${about.access === "rw" && html`
              <input inputmode="decimal" size="8" aria-label=${`${TEXT.value} ${register}`}
                disabled=${!settable} value=${typed[name] ?? ""}
                onInput=${(event) => setTyped({ ...typed, [name]: event.target.value })} />
              <button disabled=${!settable || !complete}
                onClick=${() => write(name)} aria-label=${`${TEXT.write} ${register}`}>
                ${TEXT.write}</button>`}
          </td>
          <td class="muted">${about.description}</td></tr>`;
      })}</tbody></table></div>
    ${problem}
  <//>`;
}

export function Lines({ link }) {
  useLink(link, 500);
  const [listed, setListed] = useState(null);
  const [call, problem] = useCall(link);
  const open = link.phase === "open";
  useEffect(() => {
    if (open) call("params.list", TEXT.registers).then((found) => found && setListed(found));
  }, [open]);
  if (!link.hello || !link.status) return html`<p class="muted">${TEXT.noState}</p>`;
  const registers = Object.entries(listed ?? {}).filter(([name]) => name.startsWith("drive."));
  return html`<div class="grid two">
    ${Object.entries(link.status.lines).map(([name, line]) => html`
      <${Line} key=${name} name=${name} line=${line} />`)}
    <${Trace} link=${link} />
    <p class="muted wide">${TEXT.writeOnlyDisarmed}</p>
    ${problem}
    ${link.hello.joints.map((joint) => html`<${Registers} key=${joint} link=${link} joint=${joint}
      rows=${registers.filter(([name]) => name.startsWith(`drive.${joint}.`))} />`)}
  </div>`;
}
