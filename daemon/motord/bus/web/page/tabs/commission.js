// SPDX-License-Identifier: Apache-2.0
// Guided procedures: they run on the robot, ask their questions here, and show what they measured.

import { html, useEffect, useMemo, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Difference, save, useCall, useLink } from "../parts/parts.js";
import { Picture } from "../parts/chart.js";
import { plotsOf, TimePlot } from "./plots.js";

const PRESENT_EVERY_MS = 100;
const STOP_WITHIN_MS = 1000;
const PLOT_S = 15;
const NO_STOP = ["Tab", "Shift", "Control", "Alt", "Meta", " "];  // the space bar is the e-stop

const mayMove = ({ commissioning: record }) =>
  Boolean(record) && record.end === null && record.question === null;

/** The dead-man function: the page is present while it is visible and has the focus. When it is not
 *  present any more, a motion ends at rest. */
function usePresence(link) {
  useEffect(() => {
    const stop = (why) => {
      if (!link.commissioning?.yours || !mayMove(link)) return;
      link.call("commission.stop", { why }).catch(() => {});
    };
    const conducts = () => link.commissioning?.yours && link.commissioning.end === null;
    const present = () => !document.hidden && document.hasFocus() && conducts() && link.present();
    const listeners = [
      [document, "visibilitychange", () => (document.hidden ? stop("hidden") : present())],
      [window, "focus", present],  // before a click that gives the page the focus gives an answer
      [window, "blur", () => stop("hidden")],
      [window, "pagehide", () => stop("hidden")],
      [window, "keydown", (event) => !NO_STOP.includes(event.key) && stop("key")],
      // A menu takes the keys, so that no key would stop the motion.
      [window, "contextmenu", () => stop("key")],
      [window, "dragstart", () => stop("key")],
    ];
    for (const [target, kind, listener] of listeners) target.addEventListener(kind, listener);
    const timer = setInterval(present, PRESENT_EVERY_MS);
    return () => {
      clearInterval(timer);
      for (const [target, kind, listener] of listeners) target.removeEventListener(kind, listener);
      stop("hidden");
    };
  }, [link]);
}

// ------------------------------------------------------------------------------------- the choice
const number = (text) => (text.trim() === "" ? NaN : Number(text.replace(",", ".")));

function Entry({ option, text, wrong, enter }) {
  const unit = unitOf(option);
  return html`<label><span>${option.title}</span>
    <span class="entry"><input inputmode="decimal" size="7" aria-invalid=${wrong} value=${text}
      onInput=${(event) => enter(event.target.value)} /> ${unit}</span>
    <span class="muted small">${TEXT.between(option.low, option.high, unit)}</span></label>`;
}

function Choose({ link, chosen, choose }) {
  const [typed, setTyped] = useState({});
  const [joint, setJoint] = useState("");
  const [call, problem] = useCall(link);
  const { procedures, options, joints } = link.hello;
  const { title, about } = TEXT.procedures[chosen] ?? { title: chosen, about: "" };
  const names = procedures[chosen];
  const value = (name) => number(typed[name] ?? String(options[name].usual));
  const wrong = (name) => !(value(name) >= options[name].low && value(name) <= options[name].high);
  const startable = link.mayCommand && !names.some(wrong);
  const begin = (event) => {
    event.preventDefault();
    call("commission.start", title, {
      procedure: chosen, joints: wheelsOf(chosen, joint, joints),
      options: Object.fromEntries(names.map((name) => [name, value(name)])),
    });
  };
  return html`<div class="grid commission">
    <${Card} title=${TEXT.procedure}>
      <ul class="choices">${Object.keys(procedures).map((key) => html`<li>
        <button aria-pressed=${key === chosen} onClick=${() => choose(key)}>
          ${TEXT.procedures[key]?.title ?? key}</button></li>`)}</ul>
    <//>
    <${Card} title=${title}>
      <form class="form" onSubmit=${begin}>
        <p>${about}</p>
        ${CHOOSES_WHEEL.includes(chosen) && html`<label><span>${TEXT.whichWheels}</span>
          <select value=${joint} onChange=${(event) => setJoint(event.target.value)}>
            ${chosen === "spin" && html`<option value="">${TEXT.allWheels}</option>`}
            ${joints.map((name) => html`<option value=${name}>${name}</option>`)}</select></label>`}
        ${names.map((name) => html`<${Entry} key=${name} option=${options[name]}
          text=${typed[name] ?? options[name].usual} wrong=${wrong(name)}
          enter=${(text) => setTyped({ ...typed, [name]: text })} />`)}
        <p class="muted">${TEXT.commissionHelp}</p>
        <div class="actions"><button class="main" type="submit" disabled=${!startable}>
          ${TEXT.begin}</button></div>
        ${problem}
      </form>
    <//>
  </div>`;
}

const CHOOSES_WHEEL = ["spin", "tune"];
const wheelsOf = (chosen, joint, joints) => {
  if (chosen === "tune") return [joint || joints[0]];
  return chosen === "spin" && joint ? [joint] : [];
};
const unitOf = ({ unit }) => (unit === "1" ? "" : unit);

// ------------------------------------------------------------------------------------- a question
function Question({ question, yours, answer, problem }) {
  const [typed, setTyped] = useState(question.default ?? "");
  const isNumber = question.kind === "number";
  const value = isNumber ? number(typed) : typed;
  const wrong = isNumber && !(value >= question.low && value <= question.high);
  const [sent, setSent] = useState(false);
  const open = yours && !sent;
  const give = async (given) => {
    setSent(true);
    if ((await answer(given)) === undefined) setSent(false);  // the answer was not taken
  };
  const send = (event) => { event.preventDefault(); if (!wrong) give(value); };
  const choice = (text, given, main) => html`
    <button class=${main ? "main" : ""} disabled=${!open} onClick=${() => give(given)}>
      ${text}</button>`;
  const words = () => question.answers.map((one) => choice(TEXT.words[one] ?? one, one, false));
  const { low, high, unit } = question;
  return html`<div class="question ${open ? "open" : ""}" role="group"
      aria-label=${TEXT.questionTitle}>
    <p class="asks">${question.text}</p>
    ${question.problem && html`<p class="problem" role="alert">${question.problem}</p>`}
    ${question.kind === "confirm" && html`<div class="actions">
      ${choice(TEXT.yes, true, true)}${choice(TEXT.no, false)}</div>`}
    ${question.kind === "choose" && html`<div class="actions">${words()}</div>`}
    ${(isNumber || question.kind === "text") && html`<form class="actions" onSubmit=${send}>
      <input aria-label=${question.text} inputmode=${isNumber ? "text" : undefined}
        size=${isNumber ? 8 : 24} value=${typed} disabled=${!open}
        onInput=${(event) => setTyped(event.target.value)} /> ${unit}
      <button class="main" type="submit" disabled=${!open || wrong}>${TEXT.sendAnswer}</button>
      ${isNumber && html`<span class="muted small">${TEXT.between(low, high, unit)}</span>`}
    </form>`}
    ${problem}
  </div>`;
}

// ------------------------------------------------------------------------------------ the running
function answered({ answer }) {
  if (typeof answer === "boolean") return answer ? TEXT.yes : TEXT.no;
  return TEXT.words[answer] ?? answer;
}

function Shown({ row }) {
  if (row.picture) return html`<${Picture} plot=${row.picture} />`;
  if (row.difference) return html`<${Difference} text=${row.difference} />`;
  if (row.question) return html`<p class="muted">${row.question} <b>${answered(row)}</b></p>`;
  return html`<p class="words">${row.show}</p>`;
}

function LivePlot({ link, history }) {
  const isVelocity = ({ key }) => key === "velocity";
  const plot = useMemo(() => plotsOf(link.hello, link.status).find(isVelocity), [link.hello]);
  const zoom = useMemo(() => Object.assign(() => {}, { shown: null }), []);
  return html`<${Card} title=${TEXT.plots.velocity} className="wide">
    <${TimePlot} history=${history} plot=${plot} seconds=${PLOT_S} paused=${false}
      zoom=${zoom} /><//>`;
}

function Running({ link, history, record }) {
  const [call, problem] = useCall(link);
  const { question, yours, page } = record;
  const title = TEXT.procedures[record.procedure]?.title ?? record.procedure;
  const stop = () => call("commission.stop", TEXT.stopProcedure, {}, STOP_WITHIN_MS);
  const answer = (value) =>
    call("commission.answer", TEXT.sendAnswer, { number: question.number, value });
  return html`<div class="grid commission">
    <div class="column">
      <${Card} title=${title} className=${question ? "" : "moves"}
          extra=${html`<span class="muted">${page}</span>`}>
        <button class="halt" onClick=${stop}>
          ${TEXT.stopProcedure}
          ${!question && html`<small>${TEXT.stopKey}</small>`}</button>
        ${!page && html`<p class="why">${TEXT.abandoned}</p>
          <div class="actions">
            <button class="main" onClick=${() => call("commission.take", title)}>
              ${TEXT.goOn}</button></div>`}
        ${page && !yours && html`<p class="why">${TEXT.otherConducts(page)}</p>`}
        ${question
          ? html`<${Question} key=${question.number} question=${question} yours=${yours}
              answer=${answer} problem=${problem} />`
          : html`<p class="asks" role="status">
              ${link.stale ? TEXT.next.unknown : link.progress || TEXT.preparing}</p>${problem}`}
      <//>
    </div>
    <div class="column">
      <${LivePlot} link=${link} history=${history} />
      ${record.shown.length > 0 && html`<${Card} title=${TEXT.measured} className="shown">
        ${record.shown.map((row, at) => html`<${Shown} key=${at} row=${row} />`)}<//>`}
    </div>
  </div>`;
}

function Ended({ record, close }) {
  const { good, text, file, backup, new_file: content } = record.end;
  const title = TEXT.procedures[record.procedure]?.title ?? record.procedure;
  const name = file?.split("/").at(-1);
  const result = good ? TEXT.resultGood : TEXT.resultBad;
  const download = () => save(name, content, "application/toml");
  return html`<${Card} title=${`${title}: ${result}`} className="shown ended"
      extra=${html`<button class="main" onClick=${close}>${TEXT.another}</button>`}>
    <p class=${good ? "asks" : "asks problem"} role="status">${text}</p>
    ${backup && html`<p class="good">${TEXT.writtenFile(file)} ${TEXT.restart}</p>`}
    ${content && html`<p>${TEXT.notWritable(file)}</p>
      <pre class="command" tabindex="0">${TEXT.copyCommand(file, name)}</pre>
      <div class="actions">
        <button class="main" onClick=${download}>${TEXT.downloadFile}</button></div>`}
    ${record.shown.map((row, at) => html`<${Shown} key=${at} row=${row} />`)}
  <//>`;
}

export function Commission({ link, history }) {
  useLink(link, 100);
  usePresence(link);
  const [chosen, choose] = useState("spin");
  const [closed, close] = useState(null);
  const record = link.commissioning;
  if (!link.hello || !link.now) return html`<p class="muted">${TEXT.noState}</p>`;
  if (!link.hello.may_command) {
    return html`<${Card} title=${TEXT.tabs.commission}><p>${TEXT.commissionNeedsToken}</p><//>`;
  }
  if (record && record.end === null) {
    return html`<${Running} link=${link} history=${history} record=${record} />`;
  }
  if (record && record.run !== closed) {
    return html`<${Ended} record=${record} close=${() => close(record.run)} />`;
  }
  return html`<${Choose} link=${link} chosen=${chosen} choose=${choose} />`;
}
