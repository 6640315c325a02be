// SPDX-License-Identifier: Apache-2.0
// Parts that several pages use.

import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { SYMBOLS, TEXT } from "../text.js";

/** Renders again when the robot has something new, at most once in `everyMs`. */
export function useLink(link, everyMs = 200) {
  const [, render] = useState(0);
  useEffect(() => {
    let shown = "";
    const timer = setInterval(() => {
      const version = `${link.version} ${link.staleS}`;
      if (version !== shown) render((shown = version));
    }, everyMs);
    return () => clearInterval(timer);
  }, [link, everyMs]);
}

export function number(value, digits = 2) {
  if (!Number.isFinite(value)) return "–";
  return (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);
}

export const measure = (value, digits, unit) =>
  Number.isFinite(value) ? `${number(value, digits)} ${SYMBOLS[unit]}` : "–";

export function Card({ title, extra, className = "", children }) {
  return html`<section class="card ${className}">
    ${title && html`<header><h2>${title}</h2><div class="extra">${extra}</div></header>`}
    ${children}
  </section>`;
}

export function Rows({ rows }) {
  return html`<dl class="rows">
    ${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}
  </dl>`;
}

/** Returns a function that calls the robot, the reason why a call failed, and a function that sets
 *  that reason. */
export function useCall(link) {
  const [problem, say] = useState("");
  const call = async (method, title, params, withinMs) => {
    try {
      const result = await link.call(method, params, withinMs);
      say("");
      return result;
    } catch (error) {
      say(TEXT.failed(title, error.message));
      return undefined;
    }
  };
  return [call, html`<p class="problem" role="alert">${problem}</p>`, say];
}

/** Buttons to arm, disarm, stop and reset; those that the state allows are prominent. */
export function Actions({ link }) {
  const [call, problem] = useCall(link);
  const state = link.now?.state;
  const latched = state === "fault" || state === "estop";
  const button = (method, title, main) => html`
    <button class=${main ? "main" : ""} disabled=${!link.mayCommand}
      onClick=${() => call(method, title)}>${title}</button>`;
  return html`<div class="actions">
      ${button("arm", TEXT.arm, state === "idle")}
      ${button("disarm", TEXT.disarm, false)}
      ${button("stop", TEXT.stop, state === "moving")}
      ${button("reset", TEXT.reset, latched)}
    </div>${problem}`;
}

export function Choice({ label, value, options, onChange }) {
  return html`<label class="choice"><span>${label}</span>
    <select value=${value} onChange=${(event) => onChange(event.target.value)}>
      ${options.map(([key, title]) => html`
        <option value=${key} selected=${key === value}>${title}</option>`)}
    </select></label>`;
}

/** Shows what changes in a file, as `diff -u` does. */
export function Difference({ text }) {
  const kind = (row) => (row.startsWith("+") ? "added" : row.startsWith("-") ? "removed" : "");
  return html`<pre class="diff" tabindex="0">${text.trimEnd().split("\n").map((row) =>
    html`<span class=${kind(row)}>${`${row}\n`}</span>`)}</pre>`;
}

/** Give the person a file. */
export function save(name, text, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export const colour = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
