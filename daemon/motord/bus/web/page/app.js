// SPDX-License-Identifier: Apache-2.0
// The frame around all pages: state, emergency stop, navigation.

import { html, render, useEffect, useState } from "./vendor/htm-preact.js";
import { TEXT } from "./text.js";
import { Link } from "./link.js";
import { History } from "./history.js";
import { Pilot } from "./pilot.js";
import { useLink } from "./parts/parts.js";
import { Trail } from "./parts/base_view.js";
import { battery, commander, Overview, restProblem } from "./tabs/overview.js";

const RATE_HZ = 20;
const PLOT_RATE_HZ = 50;
const link = new Link(location.origin, RATE_HZ);
const history = new History(link);
const trail = new Trail(link);
const pilot = new Pilot(link);

// Loaded when they are opened: the first paint needs the overview alone.
const PAGES = {
  overview: () => Promise.resolve(Overview),
  drive: () => import("./tabs/drive.js").then(({ Drive }) => Drive),
  plots: () => import("./tabs/plots.js").then(({ Plots }) => Plots),
  lines: () => import("./tabs/lines.js").then(({ Lines }) => Lines),
  parameters: () => import("./tabs/parameters.js").then(({ Parameters }) => Parameters),
  file: () => import("./tabs/file.js").then(({ File }) => File),
  commission: () => import("./tabs/commission.js").then(({ Commission }) => Commission),
  log: () => import("./tabs/log.js").then(({ Log }) => Log),
  fleet: () => import("./tabs/fleet.js").then(({ Fleet }) => Fleet),
};

function useTab() {
  const read = () => (location.hash.slice(1) in PAGES ? location.hash.slice(1) : "overview");
  const [tab, setTab] = useState(read);
  useEffect(() => {
    const change = () => setTab(read());
    window.addEventListener("hashchange", change);
    change();  // the address may have changed since the first drawing
    return () => window.removeEventListener("hashchange", change);
  }, []);
  return tab;
}

function NotLoaded(tab, error) {
  return html`<p class="problem" role="alert">${TEXT.notLoaded(TEXT.tabs[tab], error.message)}</p>`;
}

function Page({ tab }) {
  const [found, setFound] = useState(tab === "overview" ? { tab, Shown: Overview } : { tab: "" });
  useEffect(() => {
    let wanted = true;
    const shown = (Shown) => wanted && setFound({ tab, Shown });
    PAGES[tab]().then(shown, (error) => shown(() => NotLoaded(tab, error)));
    link.setRate(tab === "plots" ? PLOT_RATE_HZ : RATE_HZ);
    return () => { wanted = false; };
  }, [tab]);
  if (found.tab !== tab) return html`<p class="muted">${TEXT.connecting}</p>`;
  return html`<${found.Shown} link=${link} history=${history} trail=${trail} pilot=${pilot} />`;
}

let estopProblem = "";

function estop() {
  pilot.end("");
  link.estop((why) => {
    estopProblem = why && TEXT.estopDoubt(why);
    link.version += 1;
  });
}

function typesText(target) {
  const input = "input:not([type=range]):not([type=checkbox]):not([type=radio])";
  return target.matches?.(`textarea, ${input}`);
}

function pressSpace(event) {
  if (event.code !== "Space" || typesText(event.target)) return;
  event.preventDefault();
  if (event.type === "keydown" && !event.repeat) estop();
}

// Not in an effect of the page: so the key works before anything is drawn.
window.addEventListener("keydown", pressSpace, true);
window.addEventListener("keyup", pressSpace, true);

const darkSystem = matchMedia("(prefers-color-scheme: dark)");
const showTheme = () => document.dispatchEvent(new Event("motord-theme"));
darkSystem.addEventListener("change", showTheme);

function toggleTheme() {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : darkSystem.matches;
  root.dataset.theme = dark ? "light" : "dark";
  try {
    localStorage.setItem("motord.theme", root.dataset.theme);
  } catch {
    // storage is switched off: the theme lasts as long as the page
  }
  showTheme();
}

function Token() {
  const [token, setToken] = useState("");
  const send = (event) => {
    event.preventDefault();
    link.setToken(token.trim() || null);
  };
  return html`<form class="token card" onSubmit=${send}>
    <h2>${TEXT.refusedTitle}</h2>
    <p role="alert">${link.why}</p>
    <label><span>${TEXT.tokenLabel}</span>
      <input type="password" autocomplete="current-password" value=${token}
        onInput=${(event) => setToken(event.target.value)} /></label>
    <p class="muted">${TEXT.tokenHelp}</p>
    <div class="actions"><button class="main" type="submit">${TEXT.tokenSend}</button>
      ${link.token && html`<button type="button" onClick=${() => link.setToken(null)}>
        ${TEXT.tokenForget}</button>`}
    </div>
  </form>`;
}

function Banner({ askToken }) {
  if (link.phase === "lost") return html`<p class="banner bad" role="alert">${TEXT.lostText}</p>`;
  if (link.phase === "open" && link.stale && link.newest) {
    return html`<p class="banner bad" role="alert">${TEXT.staleText}</p>`;
  }
  const running = link.status?.commissioning;
  if (link.phase === "open" && running && !link.commissioning?.yours) {
    return html`<p class="banner">${TEXT.commissionedBy(running.procedure, running.page)}</p>`;
  }
  if (link.phase === "open" && !link.mayCommand) {
    if (!link.hello.takes_commands) return html`<p class="banner">${TEXT.watchOnly}</p>`;
    return html`<p class="banner">${TEXT.watching}.
      <button class="link" onClick=${askToken}>${TEXT.tokenAgain}</button></p>`;
  }
  return null;
}

/** State of the connection: the key of its text, and its class in style.css. */
function connection() {
  if (link.phase === "open") return link.stale ? "stale" : "connected";
  return link.phase === "connecting" ? "connecting" : "lost";
}

function skip(event) {
  event.preventDefault();
  document.getElementById("content").focus();
}

function Header({ tab }) {
  const state = link.now?.state ?? "unknown";
  const phase = connection();
  const name = link.hello?.robot ?? "motord";
  useEffect(() => { document.title = TEXT.title(name, TEXT.states[state]); }, [name, state]);
  return html`<header class="top">
    <a class="skip" href="#content" onClick=${skip}>${TEXT.skip}</a>
    <h1>${name}</h1>
    <span class="chip state-${state}" data-state=${state}>${TEXT.states[state]}</span>
    <span class="facts">
      <span class="fact"><b>${TEXT.commander}</b> ${commander(link)}</span>
      <span class="fact"><b>${TEXT.battery}</b> ${battery(link)}</span>
    </span>
    <span class="chip link ${phase}">${TEXT[phase]}</span>
    <button class="icon" aria-label=${TEXT.theme} title=${TEXT.theme}
      onClick=${toggleTheme}>◐</button>
    <nav aria-label=${TEXT.navigation}>${Object.entries(TEXT.tabs).map(([key, title]) =>
      html`<a href="#${key}" aria-current=${key === tab ? "page" : undefined}>${title}</a>`)}</nav>
  </header>`;
}

/** A click of a key or of a reading program has no pointer. A finger gets no click while another
 *  one is on the pad, so the button acts as soon as it is touched. */
function byKey(event) {
  if (!event.pointerType) estop();
}

function Estop() {
  const allowed = link.mayEstop;
  return html`<div class="estop-place">
    <p class="problem" role="alert">${estopProblem || restProblem(link)}</p>
    <button class="estop" disabled=${!allowed} title=${TEXT.estopHelp}
      onPointerDown=${estop} onClick=${byKey}>
      ${allowed ? TEXT.estop : TEXT.estopNoToken}
      ${allowed && html`<small>${link.stale ? TEXT.estopUnsure : TEXT.estopKey}</small>`}</button>
  </div>`;
}

function App() {
  useLink(link);
  const tab = useTab();
  const [asked, ask] = useState(false);
  useEffect(() => link.on("hello", () => ask(false)), []);
  const locked = link.phase === "refused" || asked;
  return html`
    <${Header} tab=${tab} />
    <${Banner} askToken=${() => ask(true)} />
    <main id="content" tabindex="-1">
      ${locked ? html`<${Token} />` : html`<${Page} tab=${tab} />`}</main>
    <${Estop} />`;
}

const root = document.getElementById("app");
root.textContent = "";
render(html`<${App} />`, root);
