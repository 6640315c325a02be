// SPDX-License-Identifier: Apache-2.0
// The last minute as plots, by uPlot; they are drawn from ring buffers, a few times a second.

import { html, useEffect, useMemo, useRef, useState } from "../vendor/htm-preact.js";
import uPlot from "../vendor/uPlot.js";
import { SYMBOLS, TEXT } from "../text.js";
import { Card, Choice, colour, save, useLink } from "../parts/parts.js";

const DRAW_EVERY_MS = 100;
const LATENESS_EVERY_MS = 1000;
const WINDOWS_S = [10, 30, 60];
const HEIGHT = 190;
const COLOURS = ["line-1", "line-2", "line-3", "line-4", "line-5", "line-6", "line-7", "line-8"];

const JOINT_PLOTS = [
  ["velocity", "rad_s", ["setpoint", "velocity"]], ["current", "a", ["current"]],
  ["position", "rad", ["position"]], ["temperature", "c", ["temperature"]],
  ["voltage", "v", ["voltage"]],
];

const sheet = document.createElement("link");  // only here: the first paint does not wait for it
Object.assign(sheet, { rel: "stylesheet", href: "vendor/uPlot.css" });
document.head.append(sheet);

/** Returns what is plotted: title, unit, ring and its series with label, colour and dash. */
export function plotsOf(hello, status) {
  const base = [["linear", "linear_m_s", "m_s"], ["angular", "angular_rad_s", "rad_s"]];
  if (hello.limits.lateral_m_s > 0) base[0].push(["lateral_m_s", TEXT.lateral]);
  const twist = base.map(([key, measured, unit, more]) => ({
    key, unit, ring: "fast",
    series: [
      { name: `setpoint_${measured}`, label: TEXT.setpoint, colour: "line-2", dash: [6, 4] },
      { name: measured, label: TEXT.measured, colour: "line-1" },
      ...(more ? [
        {
          name: `setpoint_${more[0]}`, label: `${more[1]}, ${TEXT.setpoint}`,
          colour: "line-4", dash: [6, 4],
        },
        { name: more[0], label: more[1], colour: "line-3" },
      ] : []),
    ],
  }));
  const joints = JOINT_PLOTS.map(([key, unit, parts]) => ({
    key, unit, ring: "fast",
    series: hello.joints.flatMap((joint, place) => parts.map((part) => ({
      name: `${part}.${place}`,
      label: part === "setpoint" ? `${joint}, ${TEXT.setpoint}` : joint,
      colour: COLOURS[place % COLOURS.length], dash: part === "setpoint" ? [6, 4] : undefined,
    }))),
  }));
  const lines = Object.keys(status?.lines ?? {});
  const trips = { key: "trips", unit: "us", ring: "slow", series: lines.flatMap((line, place) =>
    ["p50", "p99"].map((part) => ({ name: `${part} ${line}`, label: `${line} ${part}`,
      colour: COLOURS[place % COLOURS.length], dash: part === "p99" ? [6, 4] : undefined }))) };
  const errors = { key: "errors", unit: "", ring: "slow", series: lines.map((line, place) =>
    ({ name: `errors ${line}`, label: line, colour: COLOURS[place % COLOURS.length] })) };
  return [...twist, ...joints, trips, errors];
}

const FONT = "11px system-ui, sans-serif";

function axes(unit) {
  const common = {
    stroke: () => colour("muted"), grid: { stroke: () => colour("grid"), width: 1 },
    ticks: { stroke: () => colour("grid"), width: 1 }, font: FONT,
  };
  return [
    { ...common, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(2)}`) },
    { ...common, size: 58, label: SYMBOLS[unit] ?? "", labelSize: 16, labelFont: common.font },
  ];
}

const shownAs = (digits) => (_, value) =>
  (value === null || value === undefined ? "–" : value.toFixed(digits));

export function TimePlot({ history, plot, seconds, paused, zoom }) {
  const place = useRef(null);
  const state = useRef({});
  Object.assign(state.current, { seconds, paused });
  useEffect(() => {
    const names = plot.series.map(({ name }) => name);
    const chart = new uPlot({
      width: place.current.clientWidth, height: HEIGHT,
      cursor: { sync: { key: "motord" }, drag: { x: true, y: false, setScale: false } },
      legend: { live: true },
      scales: {
        x: { time: false, range: (_, low, high) => state.current.shown ?? [low ?? 0, high ?? 1] },
      },
      axes: axes(plot.unit),
      series: [
        { label: SYMBOLS.s, value: shownAs(2) },
        ...plot.series.map(({ label, colour: name, dash }) => ({
          label, stroke: () => colour(name), width: 1.5, dash, points: { show: false },
          value: shownAs(3),
        })),
      ],
      hooks: {
        setSelect: [(u) => u.select.width > 4 &&
          zoom([u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")])],
      },
    }, [[], ...names.map(() => [])], place.current);
    place.current.ondblclick = () => zoom(null);
    const draw = () => {
      const ring = history[plot.ring];
      if (!ring?.count || document.hidden || !place.current || state.current.frozen) return;
      const end = history.fast.newest;
      state.current.shown = state.current.zoomed ?? [end - state.current.seconds, end];
      chart.setData(ring.data(names, state.current.shown[0] - 1));
      state.current.frozen = state.current.paused || Boolean(state.current.zoomed);
    };
    const timer = setInterval(draw, plot.ring === "fast" ? DRAW_EVERY_MS : 5 * DRAW_EVERY_MS);
    const fit = () => chart.setSize({ width: place.current.clientWidth, height: HEIGHT });
    const size = new ResizeObserver(fit);
    size.observe(place.current);
    const again = () => { state.current.frozen = false; chart.redraw(); };
    document.addEventListener("motord-theme", again);
    state.current.chart = chart;
    return () => {
      clearInterval(timer);
      size.disconnect();
      document.removeEventListener("motord-theme", again);
      chart.destroy();
    };
  }, [history, plot]);
  useEffect(() => { state.current.frozen = false; }, [paused, seconds]);
  useEffect(() => {
    state.current.zoomed = zoom.shown;
    state.current.frozen = false;
  }, [zoom.shown]);
  return html`<div class="plot" ref=${place} data-plot=${plot.key}></div>`;
}

function Lateness({ link, history }) {
  const place = useRef(null);
  useEffect(() => {
    const bars = uPlot.paths.bars({ size: [0.9, 40] });
    const labels = (_, ticks) => ticks.map((tick) => (tick === null ? null : String(tick)));
    const chart = new uPlot({
      width: place.current.clientWidth, height: HEIGHT,
      scales: { x: { time: false, distr: 3, log: 10 }, y: { distr: 3, log: 10 } },
      axes: [
        { ...axes("us")[0], values: labels, label: SYMBOLS.us, labelSize: 16, labelFont: FONT },
        { ...axes("")[1], values: labels, label: TEXT.late },
      ],
      series: [
        { label: SYMBOLS.us, value: (_, value) => (value ? value.toFixed(1) : "–") },
        {
          label: TEXT.late, stroke: () => colour("line-1"), fill: () => colour("line-1-fill"),
          paths: bars, points: { show: false },
        },
      ],
    }, [[], []], place.current);
    let ended = false;
    const look = async () => {
      try {
        const rows = history.addLateness(await link.call("latency"));
        const shown = rows.filter(([, high]) => high > 0);
        const middles = shown.map(([low, high]) => Math.max(0.1, (low + high) / 2));
        if (!ended) chart.setData([middles, shown.map(([, , n]) => n)]);
      } catch {
        // no connection: the page shows this state
      }
    };
    look();
    const timer = setInterval(() => !document.hidden && look(), LATENESS_EVERY_MS);
    const fit = () => chart.setSize({ width: place.current.clientWidth, height: HEIGHT });
    const size = new ResizeObserver(fit);
    size.observe(place.current);
    return () => {
      ended = true;
      clearInterval(timer);
      size.disconnect();
      chart.destroy();
    };
  }, [link, history]);
  return html`<div class="plot" ref=${place} data-plot="lateness"></div>`;
}

export function Plots({ link, history }) {
  useLink(link, 500);
  const [seconds, setSeconds] = useState("30");
  const [paused, pause] = useState(false);
  const [shown, setShown] = useState(null);
  const status = useRef(null);  // the newest, which names the lines
  status.current = link.status ?? status.current;
  const lines = Object.keys(status.current?.lines ?? {}).join(" ");
  const plots = useMemo(
    () => (link.hello ? plotsOf(link.hello, status.current) : []), [link.hello, lines]);
  if (!link.hello || !link.now) return html`<p class="muted">${TEXT.noState}</p>`;
  const zoom = Object.assign((range) => setShown(range), { shown });
  const choose = (value) => {
    setShown(null);
    setSeconds(value);
  };
  const csv = () => save(`${link.hello.robot}.csv`, history.csv(), "text/csv");
  return html`<div class="plots">
    <div class="toolbar">
      <button aria-pressed=${paused} onClick=${() => pause(!paused)}>
        ${paused ? TEXT.resume : TEXT.pause}</button>
      <${Choice} label=${TEXT.window} value=${seconds} onChange=${choose}
        options=${WINDOWS_S.map((s) => [String(s), TEXT.seconds(s)])} />
      <button onClick=${csv}>${TEXT.csv}</button>
      <span class="muted">${TEXT.plotHelp} ${TEXT.dropped(link.missed)}</span>
    </div>
    <div class="grid two">
      ${plots.map((plot) => html`<${Card} key=${plot.key} title=${TEXT.plots[plot.key]}>
        <${TimePlot} history=${history} plot=${plot} seconds=${Number(seconds)}
          paused=${paused} zoom=${zoom} />
      <//>`)}
      <${Card} title=${TEXT.plots.lateness}><${Lateness} link=${link} history=${history} /><//>
    </div>
  </div>`;
}
