// SPDX-License-Identifier: Apache-2.0
// Finds what may stand at the cursor of a robot file, by its JSON Schema. Pure functions.

import { plain, scan } from "./toml.js";

/** Returns the node to which a reference or an "or null" leads. */
function resolve(schema, node = {}) {
  for (const option of node.anyOf ?? []) if (option.type !== "null") node = { ...node, ...option };
  if (!node.$ref) return node;
  const { $ref, ...own } = node;
  return { ...schema.$defs[$ref.split("/").at(-1)], ...own };
}

/** Returns the node of the kind of table that the file has chosen at that path; without a choice
 *  the node of all kinds. */
function chosen(schema, node, path, valueOf) {
  if (!node.discriminator) return node;
  const { mapping, propertyName } = node.discriminator;
  const $ref = mapping[valueOf([...path, propertyName])];
  return $ref ? { ...resolve(schema, { $ref }), discriminator: node.discriminator } : node;
}

function child(node, name) {
  const others = [...Object.values(node.patternProperties ?? {}), node.additionalProperties];
  return node.properties?.[name] ?? others.find((other) => other && typeof other === "object");
}

/** Returns the schema of what is at a path; undefined: the schema has no such path. */
function nodeAt(schema, path, valueOf) {
  let node = resolve(schema, schema);
  for (const [at, name] of path.entries()) {
    node = resolve(schema, child(node, name));
    if (node.items) node = resolve(schema, node.items);
    node = chosen(schema, node, path.slice(0, at + 1), valueOf);
  }
  return node;
}

const isTable = (node) => node.type === "object" || Boolean(node.discriminator);
const isMap = (node) => Boolean(node.patternProperties);

function choices(node) {
  if ("const" in node) return [node.const];
  if (node.type === "boolean") return [true, false];
  return node.enum ?? [];
}

/** Returns the values of `name` if it chooses the kind of its table; otherwise undefined. */
function kindsOf({ discriminator }, name) {
  return discriminator?.propertyName === name ? Object.keys(discriminator.mapping) : undefined;
}

function described(label, node, insert) {
  const { unit, minimum, maximum, description = "", type } = node;
  return {
    label, insert, unit: unit === "1" ? undefined : unit, minimum, maximum, description, type,
    fallback: node.default ?? undefined, choices: choices(node),
  };
}

/** Returns a function for the values in the text, as one table sees them: of several elements of an
 *  array only its own. */
function reader(entries, header) {
  return (path) => {
    const name = path.join("\0");
    const there = entries.filter((entry) => entry.path.join("\0") === name);
    return plain((there.find((entry) => entry.header === header) ?? there[0])?.value ?? "");
  };
}

function namesIn({ tables, entries }, path) {
  const below = [...tables, ...entries.map((entry) => entry.path)]
    .filter((other) => other.length > path.length && path.every((part, at) => other[at] === part));
  return [...new Set(below.map((other) => other[path.length]))];
}

function headers(schema, whole, end, valueOf) {
  const node = nodeAt(schema, end.parts, valueOf);
  if (isMap(node)) {
    const others = namesIn(whole, end.parts).filter((name) => name !== end.word);
    return others.map((name) => described(name, {}, name));
  }
  return Object.entries(node.properties ?? {})
    .map(([name, found]) => [name, resolve(schema, found)])
    .filter(([, found]) => isTable(found))
    .map(([name, found]) => described(name, found, isMap(found) ? `${name}.` : name));
}

/** Returns the only known key of a table whose kind is not chosen yet: the one that chooses it. */
const kindAlone = ({ mapping, propertyName }) =>
  ({ [propertyName]: { enum: Object.keys(mapping) } });

function keys(schema, whole, end, valueOf, rest) {
  const table = [...end.table, ...end.parts];
  const node = nodeAt(schema, table, valueOf);
  const others = whole.entries.filter((entry) => entry.header === end.header
    && entry.from !== end.from && entry.table.join("\0") === table.join("\0"));
  const written = new Set(others.map(({ path }) => path.at(-1)));
  const known = node.properties ?? (node.discriminator ? kindAlone(node.discriminator) : {});
  const follows = /^[ \t]*=/.test(rest);
  return Object.entries(known).filter(([name]) => !written.has(name)).map(([name, found]) => {
    const about = resolve(schema, found);
    if (follows) return described(name, about, name);
    if (!isTable(about)) return described(name, about, `${name} = `);
    if (!table.length) return described(name, about, isMap(about) ? `[${name}.` : `[${name}]`);
    return described(name, about, `${name} = { `);
  });
}

function values(schema, whole, end, valueOf) {
  const [table, name] = [end.path.slice(0, -1), end.path.at(-1)];
  const around = nodeAt(schema, table, valueOf);
  const node = nodeAt(schema, end.path, valueOf);
  const lineOfJoint = end.path[0] === "joint" && end.path.length === 3 && name === "line";
  let words = kindsOf(around, name) ?? choices(node);
  if (lineOfJoint) words = namesIn(whole, ["line"]);
  return words.map((word) => ({
    ...described(String(word), {}, JSON.stringify(word)), isDefault: word === node.default,
  }));
}

/** Returns what may replace the text from `from` to `to`: `options`, first those that begin with
 *  the word at the cursor. */
export function complete(schema, text, cursor) {
  const { end } = scan(text.slice(0, cursor));
  const whole = scan(text);
  const valueOf = reader(whole.entries, end.header);
  const after = text.slice(cursor);
  const restOfWord = /^["']/.test(end.word) ? /^[\w.-]*["']?/ : /^[\w-]*/;
  const tail = after.match(restOfWord)[0];
  let options = [];
  if (end.mode === "header") options = headers(schema, whole, end, valueOf);
  else if (end.mode === "key") {
    options = keys(schema, whole, end, valueOf, after.slice(tail.length));
  } else if (end.mode === "value" && end.path) options = values(schema, whole, end, valueOf);
  const typed = plain(end.word).toLowerCase();
  const begun = options.filter(({ label }) => label.toLowerCase().startsWith(typed));
  const others = options.filter((option) => !begun.includes(option));
  const inside = others.filter(({ label }) => label.toLowerCase().includes(typed));
  return {
    from: end.from, to: cursor + tail.length, word: end.word, mode: end.mode,
    options: [...begun, ...inside],
  };
}

/** Returns the schema's description of the key at the cursor; null: there is no description. */
export function explain(schema, text, cursor) {
  const { entries } = scan(text);
  const entry = entries.filter(({ from, to }) => from <= cursor && cursor <= to).at(-1);
  if (!entry) return null;
  const valueOf = reader(entries, entry.header);
  const node = nodeAt(schema, entry.path, valueOf);
  const around = nodeAt(schema, entry.path.slice(0, -1), valueOf);
  if (!Object.keys(node).length) return null;
  const found = described(entry.path.join("."), node, "");
  return { ...found, choices: kindsOf(around, entry.path.at(-1)) ?? found.choices };
}
