// SPDX-License-Identifier: Apache-2.0
// The robot file in an editor: completion by its schema, the findings of `motord check` at their
// lines, and the difference before it is saved.

import { html, useEffect, useLayoutEffect, useRef, useState } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";
import { Card, Difference, save as download, useCall, useLink } from "../parts/parts.js";
import { complete, explain } from "../parts/completion.js";
import { plain } from "../parts/toml.js";

const CHECK_AFTER_MS = 600;
const ANSWER_WITHIN_MS = 60000;  // the robot checks for several pages one after the other
const LINE_PX = 20;              // as in style.css
const PAD_PX = 8;
const TAB_COLUMNS = 8;
const MOVES = ["ArrowLeft", "ArrowRight", "Home", "End", "PageUp", "PageDown"];
const HELP = "file-help";
const LIST = "file-completion";

/** The text being written. It stays while another page of the dashboard is shown. */
const draft = { base: null, text: "" };
const changed = () => draft.base !== null && draft.text !== draft.base.text;

function loaded({ file, sha256, text }) {
  const lineEnd = text.includes("\r\n") ? "\r\n" : "\n";
  return { file, sha256, text: text.replaceAll("\r\n", "\n"), lineEnd };
}
const onDisk = () => draft.text.replaceAll("\n", draft.base.lineEnd);

/** Replaces text as if a person typed it, so that the browser can undo it. */
function replace(area, from, to, text) {
  area.focus();
  area.setSelectionRange(from, to);
  if (document.execCommand(text ? "insertText" : "delete", false, text)) return;
  area.setRangeText(text, from, to, "end");
  area.dispatchEvent(new Event("input", { bubbles: true }));
}

function useSchema() {
  const [schema, setSchema] = useState(null);
  useEffect(() => {
    fetch("robot.schema.json").then((answer) => answer.json()).then(setSchema, () => {});
  }, []);
  return schema;
}

/** Returns whether a completion is worth showing while a person types. */
const worth = ({ options, word, mode }, typed) => options.length > 0
  && !(options.length === 1 && options[0].label === plain(word))
  && (word !== "" || mode === "value" || typed === "[" || typed === ".");

function columnsOf(text) {
  let columns = 0;
  for (const character of text) {
    columns += character === "\t" ? TAB_COLUMNS - (columns % TAB_COLUMNS) : 1;
  }
  return columns;
}

const facts = ({ unit, minimum, maximum, fallback, choices, isDefault }) => [
  unit,
  minimum !== undefined && maximum !== undefined ? TEXT.between(minimum, maximum, "").trim() : "",
  fallback !== undefined ? TEXT.fallback(JSON.stringify(fallback)) : "",
  choices?.length ? choices.join(", ") : "",
  isDefault ? TEXT.isFallback : "",
].filter(Boolean).join("; ");

function Completion({ found, active, place, accept }) {
  const list = useRef(null);
  useEffect(() => {
    const selected = list.current?.querySelector("[aria-selected=true]");
    selected?.scrollIntoView({ block: "nearest" });
  }, [active]);
  return html`<ul ref=${list} id=${LIST} role="listbox" aria-label=${TEXT.completions}
      class="completion" style=${place} onMouseDown=${(event) => event.preventDefault()}>
    ${found.options.map((option, at) => html`<li key=${option.label} id=${`${LIST}-${at}`}
      role="option" aria-selected=${at === active} onMouseDown=${() => accept(option)}>
      <b>${option.label}</b> <span class="muted">${facts(option)}</span>
      ${option.description && html`<span class="small">${option.description}</span>`}</li>`)}
  </ul>`;
}

const topOf = (line) => ({ top: `${PAD_PX + (line - 1) * LINE_PX}px` });

/** The text area with its lines; `marks`: line → "error" or "warning". */
function Editor({ area, schema, marks, edited, compare }) {
  const [found, setFound] = useState(null);
  const [active, setActive] = useState(-1);
  const [about, setAbout] = useState(null);
  const [lines, setLines] = useState(1);
  const gutter = useRef(null);
  const accepting = useRef(false);
  const close = () => { setFound(null); setActive(-1); };
  const look = (forced, typed) => {
    const { value, selectionStart, selectionEnd } = area.current;
    if (!schema || selectionStart !== selectionEnd) return close();
    const now = complete(schema, value, selectionStart);
    setAbout(explain(schema, value, selectionStart));
    if (forced ? now.options.length === 0 : !worth(now, typed)) return close();
    setActive(forced ? 0 : -1);
    return setFound(now);
  };
  const count = () => setLines(area.current.value.split("\n").length);
  useLayoutEffect(() => {  // before a key reaches the area and its text replaces the draft
    area.current.value = draft.text;
    count();
  }, []);
  const input = (event) => {
    count();
    edited(area.current.value);
    look(false, accepting.current ? "." : event.data);
  };
  const accept = (option) => {
    accepting.current = true;
    replace(area.current, found.from, found.to, option.insert);
    accepting.current = false;
  };
  const press = (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    let taken = true;
    if (event.ctrlKey && event.code === "Space") look(true);
    else if ((event.ctrlKey || event.metaKey) && event.key === "s") compare();
    else if (found && event.key === "Escape") close();
    else if (found && step && !event.shiftKey && (active >= 0 || step > 0)) {
      setActive((active + step + found.options.length) % found.options.length);
    } else if (found && event.key === "Enter" && active >= 0) accept(found.options[active]);
    else taken = false;
    if (taken) event.preventDefault();
  };
  const moved = () => {
    close();
    if (schema) setAbout(explain(schema, area.current.value, area.current.selectionStart));
  };
  const released = ({ key }) => {
    if (MOVES.includes(key) || (!found && key.startsWith("Arrow"))) moved();
  };
  const place = () => {
    const { value, scrollTop, scrollLeft, clientHeight, offsetHeight } = area.current;
    const rows = value.slice(0, found.from).split("\n");
    const below = PAD_PX + rows.length * LINE_PX - scrollTop;
    const above = offsetHeight - below + LINE_PX;
    return {
      ...(2 * below > clientHeight ? { bottom: `${above}px` } : { top: `${below}px` }),
      left: `min(calc(${columnsOf(rows.at(-1))}ch + ${PAD_PX - scrollLeft}px), 40%)`,
    };
  };
  const scrolled = () => {
    gutter.current.scrollTop = area.current.scrollTop;
    if (found) setFound({ ...found });  // the list moves with its word
  };
  return html`<div class="editor">
      <div class="gutter" ref=${gutter} aria-hidden="true">
        <pre>${Array.from({ length: lines }, (_, at) => at + 1).join("\n")}</pre>
        ${[...marks].map(([line, kind]) => html`
          <i key=${line} class=${kind} style=${topOf(line)}>${line}</i>`)}
      </div>
      <div class="writing">
        <textarea ref=${area} wrap="off" spellcheck=${false} autocomplete="off"
          autocapitalize="off" aria-label=${TEXT.tabs.file}
          aria-describedby=${HELP} aria-autocomplete="list"
          aria-controls=${found ? LIST : undefined}
          aria-activedescendant=${found && active >= 0 ? `${LIST}-${active}` : undefined}
          onInput=${input} onKeyDown=${press} onKeyUp=${released} onClick=${moved} onBlur=${close}
          onScroll=${scrolled}></textarea>
        ${found && html`<${Completion} found=${found} active=${active} place=${place()}
          accept=${accept} />`}
      </div>
    </div>
    <p class="about">${about ? html`<b>${about.label}</b>${" "}
      <span class="muted">${facts(about)}</span> ${about.description}` : TEXT.aboutKey}</p>`;
}

function Messages({ report, state, go }) {
  const { problems = [], warnings = [] } = report ?? {};
  const row = (kind) => ({ line, key, text }) => html`<li class=${kind}>
    ${line > 0 && html`<button class="link" onClick=${() => go(line)}>
      ${TEXT.atLine(line)}</button> `}
    ${kind === "warning" && html`<b>${TEXT.warning}</b> `}
    ${key && html`<b>${key}</b> `}${text}</li>`;
  const counts = report ? TEXT.checked(problems.length, warnings.length) : "";
  return html`
    <p class="checked" role="status">${state === "checking" ? TEXT.checking : counts}</p>
    <ul class="messages" aria-label=${TEXT.messages}>
      ${problems.map(row("error"))}${warnings.map(row("warning"))}</ul>`;
}

/** Returns the kind of outcome that an answer to file.diff or file.save means. */
function kindOf(found) {
  if (found.changed) return "conflict";
  if (found.problems.length) return "problems";
  if (found.unwritable) return "unwritable";
  return found.backup ? "written" : "compared";
}

/** The outcome of saving. */
function Outcome({ outcome, mayWrite, write, close, keep, discard }) {
  const { kind, found } = outcome;
  const name = found.file.split("/").at(-1);
  const text = {
    compared: found.diff ? TEXT.wouldSave(found.file) : TEXT.sameFile(found.file),
    written: `${TEXT.writtenFile(found.file)} ${TEXT.restart}`,
    conflict: TEXT.conflict,
    unwritable: TEXT.notWritable(found.file),
    problems: TEXT.notSaved,
  }[kind];
  const compared = kind === "compared";
  const toWrite = compared && found.diff;
  const save = () => download(name, onDisk(), "application/toml");
  return html`<div class="difference" role="region" aria-label=${TEXT.difference}>
    <p role=${compared ? undefined : "alert"} class=${kind === "written" ? "good" : ""}>
      ${text}</p>
    ${kind === "unwritable" && html`<p class="muted">${found.unwritable}</p>
      <pre class="command" tabindex="0">${TEXT.copyCommand(found.file, name)}</pre>`}
    ${compared && !mayWrite && html`<p class="muted">${TEXT.writingNeedsToken}</p>`}
    ${found.diff && kind !== "problems" && html`<${Difference} text=${found.diff} />`}
    <div class="actions">
      ${toWrite && mayWrite && html`
        <button class="main" onClick=${write}>${TEXT.write}</button>`}
      ${kind === "unwritable" && html`
        <button class="main" onClick=${save}>${TEXT.downloadFile}</button>`}
      ${kind === "conflict" && html`<button class="main" onClick=${keep}>${TEXT.keepMine}</button>
        <button onClick=${discard}>${TEXT.takeTheirs}</button>`}
      <button onClick=${close}>${toWrite ? TEXT.cancel : TEXT.close}</button>
    </div>
  </div>`;
}

/** `check` checks at once, `later` when the person has paused. One check runs at a time; text that
 *  was written meanwhile is checked after it. */
function useCheck(call, setReport) {
  const [state, setState] = useState("");
  const running = useRef(false);
  const timer = useRef(0);
  const check = async () => {
    clearTimeout(timer.current);
    if (running.current) return;
    running.current = true;
    setState("checking");
    const text = draft.text;
    const found = await call("file.check", TEXT.check, { text: onDisk() }, ANSWER_WITHIN_MS);
    running.current = false;
    setState("");
    if (found) setReport(found);
    if (text !== draft.text) later();
  };
  const later = () => {
    clearTimeout(timer.current);
    timer.current = setTimeout(check, CHECK_AFTER_MS);
  };
  useEffect(() => () => clearTimeout(timer.current), []);
  return { state, check, later };
}

/** Returns the marks of the lines; an error replaces a warning of the same line. */
function marksOf({ warnings = [], problems = [] }) {
  const rows = [
    ...warnings.map(({ line }) => [line, "warning"]),
    ...problems.map(({ line }) => [line, "error"]),
  ];
  return new Map(rows.filter(([line]) => line > 0));
}

export function File({ link }) {
  useLink(link, 500);
  const [call, problem] = useCall(link);
  const [report, setReport] = useState(null);
  const [outcome, setOutcome] = useState(null);
  const [base, setBase] = useState(draft.base);
  const [dirty, setDirty] = useState(changed());
  const schema = useSchema();
  const area = useRef(null);
  const { state, check, later } = useCheck(call, setReport);
  const usable = link.permitted;

  const take = (found) => {
    draft.base = loaded(found);
    setBase(draft.base);
    setReport(found);
    setDirty(changed());
  };
  const load = async (kept) => {
    const found = await call("file.read", TEXT.tabs.file, {}, ANSWER_WITHIN_MS);
    if (!found) return;
    take(found);
    setOutcome(null);
    if (kept) compare();
    else if (area.current) replace(area.current, 0, area.current.value.length, draft.base.text);
    else draft.text = draft.base.text;
    setDirty(changed());
  };
  useEffect(() => {
    if (usable && !draft.base) load(false);
    else if (usable) check();
  }, [usable]);
  useEffect(() => {
    const leave = (event) => { if (changed()) event.preventDefault(); };
    window.addEventListener("beforeunload", leave);
    return () => window.removeEventListener("beforeunload", leave);
  }, []);

  const edited = (text) => {
    draft.text = text;
    setDirty(changed());
    setOutcome(null);
    later();
  };
  const ask = async (method) => {
    const text = draft.text;
    const params = { text: onDisk(), sha256: draft.base.sha256 };
    const found = await call(method, TEXT.save, params, ANSWER_WITHIN_MS);
    if (!found || text !== draft.text && !found.backup) return;
    const kind = kindOf(found);
    if (found.problems) setReport(found);
    if (found.backup) take({ ...found, text: text.replaceAll("\n", draft.base.lineEnd) });
    setOutcome({ kind, found });
  };
  const compare = () => ask("file.diff");
  const go = (line) => {
    const before = area.current.value.split("\n").slice(0, line - 1);
    const start = before.join("\n").length + (line > 1 ? 1 : 0);
    area.current.focus();
    area.current.setSelectionRange(start, start);
    area.current.scrollTop = Math.max(0, (line - 5) * LINE_PX);
  };

  if (!link.hello) return html`<p class="muted">${TEXT.connecting}</p>`;
  if (!link.hello.may_command) {
    return html`<${Card} title=${TEXT.tabs.file}><p>${TEXT.fileNeedsToken}</p><//>`;
  }
  const marks = marksOf(report ?? {});
  return html`<${Card} title=${base?.file ?? TEXT.tabs.file} className="robot-file" extra=${html`
      <span class="muted">${dirty ? TEXT.fileChanged : TEXT.unchanged}</span>
      <button disabled=${!usable || !base} onClick=${check}>${TEXT.check}</button>
      <button disabled=${!usable} onClick=${() => load(false)}>
        ${dirty ? TEXT.takeTheirs : TEXT.loadAgain}</button>
      <button class="main" disabled=${!usable || !dirty} onClick=${compare}>
        ${TEXT.save}</button>`}>
    ${problem}
    ${outcome && html`<${Outcome} outcome=${outcome} mayWrite=${link.hello.may_write}
      write=${() => ask("file.save")} close=${() => setOutcome(null)}
      keep=${() => load(true)} discard=${() => load(false)} />`}
    ${base
      ? html`<${Editor} area=${area} schema=${schema} marks=${marks} edited=${edited}
          compare=${compare} />`
      : html`<p class="muted">${TEXT.connecting}</p>`}
    ${base && html`<${Messages} report=${report} state=${state} go=${go} />`}
    <p class="muted" id=${HELP}>${TEXT.fileHelp}</p>
  <//>`;
}
