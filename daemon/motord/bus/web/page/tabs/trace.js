// SPDX-License-Identifier: Apache-2.0
// Shows the exchanges of a line as they happen. The robot traces only while this is visible.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Choice, number, useCall } from "../parts/parts.js";

const KEPT_MAX = 500;
const SHOWN_MAX = 100;

const clock = (seconds) => {
  const date = new Date(seconds * 1000);
  const milliseconds = String(date.getMilliseconds()).padStart(3, "0");
  return `${date.toLocaleTimeString([], { hour12: false })}.${milliseconds}`;
};
const spaced = (hex) => hex.replace(/../g, "$& ").trim();
const bytesOf = ({ sent, received }) => [sent, received].filter(Boolean).map(spaced).join(" → ");
const textOf = (row) =>
  `${row.joint} ${row.what} ${row.result} ${bytesOf(row)}`.toLowerCase();

const replyAfter = ({ reply_us }) =>
  reply_us === null ? "" : `${number(reply_us / 1000, 2)} ms`;

/** Returns whether this page of the browser is visible. */
function useVisible() {
  const [visible, setVisible] = useState(!document.hidden);
  useEffect(() => {
    const look = () => setVisible(!document.hidden);
    document.addEventListener("visibilitychange", look);
    return () => document.removeEventListener("visibilitychange", look);
  }, []);
  return visible;
}

export function Trace({ link }) {
  const lines = Object.keys(link.status?.lines ?? {});
  const [line, setLine] = useState(lines[0] ?? "");
  const [on, setOn] = useState(false);
  const [paused, setPaused] = useState(false);
  const [failures, setFailures] = useState(false);
  const [filter, setFilter] = useState("");
  const [shown, setShown] = useState({ rows: [], skipped: 0 });
  const [ended, setEnded] = useState("");
  const [call, problem] = useCall(link);
  const visible = useVisible();
  const open = link.phase === "open";
  const looks = on && !paused && visible && open;
  useEffect(() => {
    if (!looks) return undefined;
    setEnded("");
    const stop = link.on("trace", (found) => {
      if (found.line !== line) return;
      if (found.problem) {
        setEnded(found.problem);
        setOn(false);
      } else {
        setShown(({ rows, skipped }) => ({
          rows: [...rows, ...found.rows].slice(-KEPT_MAX), skipped: skipped + found.skipped,
        }));
      }
    });
    call("trace", TEXT.trace, { line });
    return () => {
      stop();
      link.call("trace", { line: null }).catch(() => {});  // without a connection it has ended
    };
  }, [looks, line]);
  const choose = (name) => {
    setLine(name);
    setShown({ rows: [], skipped: 0 });
  };
  const turn = () => {
    setOn(!on);
    setPaused(false);
  };
  const wanted = filter.toLowerCase();
  const rows = shown.rows
    .filter((row) => !failures || row.failed)
    .filter((row) => !wanted || textOf(row).includes(wanted))
    .slice(-SHOWN_MAX).reverse();
  return html`<${Card} className="wide trace" title=${TEXT.trace} extra=${html`
      ${lines.length > 1 && html`<${Choice} label=${TEXT.line} value=${line}
        options=${lines.map((name) => [name, name])} onChange=${choose} />`}
      <button aria-pressed=${on} onClick=${turn}>${on ? TEXT.traceHide : TEXT.traceShow}</button>
      ${on && html`<button aria-pressed=${paused} onClick=${() => setPaused(!paused)}>
        ${paused ? TEXT.resume : TEXT.pause}</button>`}`}>
    <p class="muted">${TEXT.traceHelp}</p>
    ${problem}
    ${ended && html`<p class="problem" role="alert">${TEXT.failed(TEXT.trace, ended)}</p>`}
    ${(on || shown.rows.length > 0) && html`<div class="toolbar">
        <input type="search" aria-label=${TEXT.filter} placeholder=${TEXT.filter} value=${filter}
          onInput=${(event) => setFilter(event.target.value)} />
        <label class="check"><input type="checkbox" checked=${failures}
          onChange=${(event) => setFailures(event.target.checked)} /> ${TEXT.traceFailures}</label>
        <span class="muted">${TEXT.traceSkipped(shown.skipped)}</span></div>
      <div class="table exchanges" tabindex="0" role="region" aria-label=${TEXT.trace}><table>
        <thead><tr><th scope="col">${TEXT.time}</th><th scope="col">${TEXT.joint}</th>
          <th scope="col">${TEXT.result}</th><th scope="col" class="num">${TEXT.reply}</th>
          <th scope="col">${TEXT.meaning}</th><th scope="col">${TEXT.bytes}</th></tr></thead>
        <tbody>${rows.map((row) => html`
          <tr key=${`${row.time_s} ${row.sent}`} class=${row.failed ? "bad" : ""}>
            <td>${clock(row.time_s)}</td><td>${row.joint}</td><td>${row.result}</td>
            <td class="num">${replyAfter(row)}</td>
            <td>${row.what}</td><td class="bytes">${bytesOf(row)}</td></tr>`)}
        </tbody></table></div>`}
  <//>`;
}
