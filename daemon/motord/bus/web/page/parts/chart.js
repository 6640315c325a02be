// SPDX-License-Identifier: Apache-2.0
// What a procedure has measured, drawn once as SVG: curves and points over two axes, or bars.

import { html } from "../vendor/htm-preact.js";
import { TEXT } from "../text.js";

const WIDTH = 460;
const HEIGHT = 300;
const EDGE = { left: 58, right: 12, top: 10, bottom: 40 };
const COLOURS = 8;
const finite = (values) => values.filter((value) => value !== null);

/** Returns about `count` round numbers from `low` to `high`. */
function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= rough);
  const found = [];
  for (let at = Math.ceil(low / step); at * step <= high + step * 1e-9; at += 1) {
    found.push(Number((at * step).toPrecision(12)));
  }
  return found;
}

/** Returns the lowest and the highest value with a margin; they always differ. */
function span(values, withZero = false) {
  const all = withZero ? [0, ...values] : values;
  const low = Math.min(...all);
  const high = Math.max(...all);
  const margin = 0.06 * (high - low) || 0.5 * Math.abs(high) || 1;
  return [low - margin, high + margin];
}

/** Returns ranges with the same number of metres for a pixel on both axes. */
function equalized([x0, x1], [y0, y1], width, height) {
  const scale = Math.max((x1 - x0) / width, (y1 - y0) / height);
  const around = (low, high, length) =>
    [(low + high - scale * length) / 2, (low + high + scale * length) / 2];
  return [around(x0, x1, width), around(y0, y1, height)];
}

const axisTitle = ({ title, unit }) => (unit === "1" ? title : `${title}, ${unit}`);

function Frame({ plot, x, y, toX, toY, children }) {
  const right = WIDTH - EDGE.right;
  const bottom = HEIGHT - EDGE.bottom;
  const lineAt = (at) => (at === 0 ? "zero" : "rule");
  return html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label=${plot.title}>
    ${ticks(...y, 5).map((at) => html`
      <line class=${lineAt(at)} x1=${EDGE.left} x2=${right} y1=${toY(at)} y2=${toY(at)} />
      <text x=${EDGE.left - 6} y=${toY(at) + 4} class="end">${at}</text>`)}
    ${x && ticks(...x, 6).map((at) => html`
      <line class=${lineAt(at)} y1=${EDGE.top} y2=${bottom} x1=${toX(at)} x2=${toX(at)} />
      <text x=${toX(at)} y=${bottom + 16} class="middle">${at}</text>`)}
    ${plot.x && html`<text x=${(EDGE.left + right) / 2} y=${HEIGHT - 6} class="middle">
      ${axisTitle(plot.x)}</text>`}
    <text transform="translate(13 ${(EDGE.top + bottom) / 2}) rotate(-90)" class="middle">
      ${axisTitle(plot.y)}</text>
    ${children}
  </svg>`;
}

function Curve({ series, colour, toX, toY }) {
  const points = series.x.map((x, place) => [x, series.y[place]])
    .filter(([x, y]) => x !== null && y !== null)
    .map(([x, y]) => [toX(x).toFixed(1), toY(y).toFixed(1)]);
  if (series.style === "points") {
    return points.map(([x, y]) => html`<circle class=${colour} cx=${x} cy=${y} r="3.5" />`);
  }
  if (series.style === "crosses") {
    return points.map(([x, y]) => html`<path class="cross" d=${`M${x} ${y}m-6 0h12m-6 -6v12`} />`);
  }
  const corners = points.map((point) => point.join(",")).join(" ");
  return html`<polyline class="${colour} ${series.style}" points=${corners} />`;
}

/** Returns the subject of a series: those of one subject, before and after, share a colour. */
const subject = (title) => title.split(", ")[0];

function colours(series) {
  const known = [...new Set(series.map(({ title }) => subject(title)))];
  return series.map(({ title }) => `c${(known.indexOf(subject(title)) % COLOURS) + 1}`);
}

function Curves({ plot }) {
  const width = WIDTH - EDGE.left - EDGE.right;
  const height = HEIGHT - EDGE.top - EDGE.bottom;
  let x = span(finite(plot.series.flatMap((series) => series.x)));
  let y = span(finite(plot.series.flatMap((series) => series.y)));
  if (plot.equal) [x, y] = equalized(x, y, width, height);
  const toX = (value) => EDGE.left + (width * (value - x[0])) / (x[1] - x[0]);
  const toY = (value) => EDGE.top + height - (height * (value - y[0])) / (y[1] - y[0]);
  const shades = colours(plot.series);
  return html`<${Frame} plot=${plot} x=${x} y=${y} toX=${toX} toY=${toY}>
    ${plot.series.map((series, place) => html`
      <${Curve} series=${series} colour=${shades[place]} toX=${toX} toY=${toY} />`)}
  <//>`;
}

function Bars({ plot }) {
  const width = WIDTH - EDGE.left - EDGE.right;
  const height = HEIGHT - EDGE.top - EDGE.bottom;
  const y = span(finite(plot.series.flatMap((series) => series.y)), true);
  const toY = (value) => EDGE.top + height - (height * (value - y[0])) / (y[1] - y[0]);
  const room = width / plot.bars.length;
  const each = (0.76 * room) / plot.series.length;
  const left = (bar, place) => EDGE.left + room * (bar + 0.12) + each * place;
  return html`<${Frame} plot=${plot} y=${y} toY=${toY}>
    ${plot.bars.map((_, bar) => plot.series.map((series, place) => {
      const value = series.y[bar];
      if (value === null) return null;
      const ends = [toY(value), toY(0)];
      return html`<rect class="c${(place % COLOURS) + 1}" x=${left(bar, place)} width=${0.92 * each}
        y=${Math.min(...ends)} height=${Math.max(1, Math.abs(ends[0] - ends[1]))} />`;
    }))}
    ${plot.bars.map((_, bar) => html`
      <text x=${EDGE.left + room * (bar + 0.5)} y=${HEIGHT - EDGE.bottom + 16} class="middle">
        ${bar + 1}</text>`)}
  <//>`;
}

const shown = (value) => (value === null ? "–" : Number(value.toPrecision(3)));

/** The numbers of the bars as a table, for people who cannot see them, and for exact values. */
function Numbers({ plot }) {
  const name = `${plot.title}: ${TEXT.values}`;
  return html`<div class="table" tabindex="0" role="region" aria-label=${name}><table>
    <thead><tr><td></td>${plot.series.map(({ title }, place) => html`
      <th scope="col" class="num key c${(place % COLOURS) + 1}">${title}, ${plot.y.unit}</th>`)}
    </tr></thead>
    <tbody>${plot.bars.map((title, bar) => html`<tr><th scope="row">${bar + 1} ${title}</th>
      ${plot.series.map((series) => html`<td class="num">${shown(series.y[bar])}</td>`)}
    </tr>`)}</tbody>
  </table></div>`;
}

export function Picture({ plot }) {
  const shades = plot.bars ? [] : colours(plot.series);
  const mark = (style, place) => (style === "crosses" ? "cross" : shades[place]);
  const bars = () => html`<${Bars} plot=${plot} /><${Numbers} plot=${plot} />`;
  const curves = () => html`<${Curves} plot=${plot} />
    <ul class="keys">${plot.series.map(({ title, style }, place) => html`
      <li class="key ${style} ${mark(style, place)}">${title}</li>`)}</ul>`;
  return html`<figure class="picture">
    <figcaption>${plot.title}</figcaption>
    ${plot.bars ? bars() : curves()}
  </figure>`;
}
