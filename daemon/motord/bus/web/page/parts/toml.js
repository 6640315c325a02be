// SPDX-License-Identifier: Apache-2.0
// Reads a TOML text that is being written (https://toml.io/en/v1.0.0): a part that is not finished,
// or wrong, ends with its line.

const anyOf = (...patterns) => patterns.map(({ source }) => source).join("|");

const SKIPPED = /[ \t\r]+|#[^\n]*/;
const LONG_STRING = /"""(?:\\[^]|[^\\])*?(?:"{3,5}|$)|'''[^]*?(?:'{3,5}|$)/;
const STRING = /"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?/;
const BARE = /[^\s"'[\]{}=.,#]+/;
const WRITTEN = anyOf(LONG_STRING, STRING, BARE);
const MARK = /[\n[\]{}=.,]/;
const TOKEN = new RegExp(`(${SKIPPED.source})|(${WRITTEN})|(${MARK.source})`, "y");
const HEADER = /\[{1,2}[ \t]*[A-Za-z_][^\n=,"']*\][ \t\r]*(?:#[^\n]*)?(?:\n|$)/;
const KEY = /[A-Za-z_][\w.-]*[ \t]*=/;
/** Matches at the beginning of a line what no element of an array looks like: an array above it was
 *  not closed. */
const ANEW = new RegExp(anyOf(HEADER, KEY), "y");

/** Returns the text of a key or of a string, as far as it is written. */
export function plain(word) {
  const mark = word[0];
  if (mark !== '"' && mark !== "'") return word;
  return word.slice(1, word.length > 1 && word.endsWith(mark) ? -1 : undefined);
}

/**
 * Returns `tables`, `entries` and `end`.
 * `tables`: paths of the tables, in order.
 * `entries`: keys with a value: `path` and that of the `table` around it, `header` (the number of
 * tables before it), `value` as it is written, `from`, `to`.
 * `end`: what the text ends in: `mode` ("key", "header", "value" or ""), `table` or `path`, the
 * `parts` of a key before its last dot, and the `word` that begins at `from`.
 */
export function scan(text) {
  const tables = [];
  const entries = [];
  let table = [];
  let open = [];  // arrays and inline tables around, the innermost last
  let mode = "key";
  let parts = [];
  let entry = null;
  let start = 0;
  let last = { word: "", from: 0, to: 0 };  // a word or a mark; of a mark the word is empty
  const around = () => (open.length ? open.at(-1).path : table);

  const mark = (word, at) => {
    if (word === "\n") {
      ANEW.lastIndex = at + 1;
      const ends = !open.at(-1)?.array || ANEW.test(text);
      if (ends) [open, mode, parts, entry] = [[], "key", [], null];
    } else if (word === "[") {
      if (mode === "value") open.push({ array: true, path: entry.path, entry });
      else if (mode === "key" && !open.length && !parts.length) mode = "header";
    } else if (word === "]" && mode === "header") {
      if (parts.length) tables.push((table = parts));
      [mode, parts] = ["", []];
    } else if (word === "{" && mode === "value") {
      open.push({ array: false, path: entry.path, entry });
      [mode, parts] = ["key", []];
    } else if (word === "]" || word === "}") {
      entry = open.pop()?.entry ?? null;
      mode = "";
    } else if (word === "=" && mode === "key" && parts.length) {
      entry = {
        path: [...around(), ...parts], table: [...around(), ...parts.slice(0, -1)],
        header: tables.length, value: "", from: start,
      };
      entries.push(entry);
      [mode, parts] = ["value", []];
    } else if (word === ",") {
      [mode, parts] = [open.at(-1)?.array ? "value" : open.length ? "key" : "", []];
      if (mode === "key") entry = null;
    }
  };

  TOKEN.lastIndex = 0;
  for (let found; (found = TOKEN.exec(text)); ) {
    const [word, skipped, written, marked] = found;
    const to = TOKEN.lastIndex;
    if (skipped === undefined) {
      last = { word: written ?? "", from: written === undefined ? to : found.index, to };
    } else if (word[0] === "#" && to === text.length) mode = "";
    if (marked !== undefined) mark(marked, found.index);
    else if (written !== undefined && mode === "value") entry.value ||= word;
    else if (written !== undefined && mode !== "") {
      if (!parts.length) start = found.index;
      parts.push(plain(word));
    }
    if (entry && skipped === undefined && marked !== "\n") entry.to = to;
  }
  const touches = last.to === text.length && last.word !== "";
  const end = touches ? { word: last.word, from: last.from } : { word: "", from: text.length };
  if (touches && mode !== "value") parts = parts.slice(0, -1);
  if ((last.word && !touches) || /^("""|''')/.test(end.word)) mode = "";
  const within = { table: around(), path: entry?.path, header: tables.length };
  return { tables, entries, end: { ...end, mode, parts, ...within } };
}
