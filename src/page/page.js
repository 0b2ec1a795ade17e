"use strict";

// The data are unpacked, the page is drawn, and then everything follows from `now`: the tick, the chosen agent, the chosen clause.

const COLOURS = { Slow: "#b87a00", Normal: "#3f7fb5", Fast: "#0a8a63", Stop: "#c8401a" };
/** How far to turn what faces up, clockwise. */
const TURNS = { Up: 0, Right: Math.PI / 2, Down: Math.PI, Left: -Math.PI / 2 };
const SPEEDS = [1, 2, 5, 10, 20, 50];
const $ = (id) => document.getElementById(id);

main().catch((error) => {
  $("fault").hidden = false;
  $("fault").textContent = `This page cannot be shown: ${error.message}`;
  throw error;
});

async function main() {
  if (!("DecompressionStream" in window)) {
    throw new Error("the browser is too old; Chromium 80, Firefox 113 or Safari 16.4 and later can open it");
  }
  const data = await unpack($("data").textContent);
  $("data").remove();
  const bitmaps = data.icons.map(async (icon) => createImageBitmap(new Blob([bytesOf(icon)], { type: "image/png" })));
  new View(data, await Promise.all(bitmaps));
}

/** What stands in base 64. */
function bytesOf(text) {
  return Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
}

/** What stands in base 64, deflated, as JSON. */
async function unpack(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

/** An element with attributes and children; texts are never read as markup. */
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child != null));
  return element;
}

class View {
  constructor(data, icons) {
    this.data = data;
    this.icons = icons;
    this.count = data.ticks.length;
    this.names = new Map(data.agents.map((agent, index) => [agent.id, index]));
    this.now = { tick: 0, agent: -1, clause: -1, playing: false, speed: 5, follow: false, part: 0 };
    this.hover = -1;
    this.facts = this.unfoldFacts();
    this.firings = this.collectFirings();
    this.progress = this.measureProgress();
    this.stillMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.camera = null;
    this.fill();
    this.drawGround();
    this.drawStrip();
    this.listen();
    this.readAddress();
    this.resize();
    this.refresh();
  }

  // ---- What follows from the data -------------------------------------------------------------------------------------------

  /** For every tick the rows of every predicate; ticks without a change share them. */
  unfoldFacts() {
    let rows = this.data.predicates.map(() => []);
    return this.data.ticks.map(({ facts }) => {
      if (facts.length) rows = rows.slice();
      for (const [predicate, flat] of facts) rows[predicate] = flat;
      return rows;
    });
  }

  /** For every clause, [tick, agent] of its firings in order. */
  collectFirings() {
    const firings = this.data.clauses.map(() => []);
    this.data.ticks.forEach(({ fired }, tick) => {
      fired.forEach((clauses, agent) => clauses.forEach((clause) => firings[clause].push([tick, agent])));
    });
    return firings;
  }

  /** For every agent and tick, how many cells it has gone on its route, and which route that is. */
  measureProgress() {
    return this.data.agents.map((_, agent) => {
      const routes = this.data.routes[agent];
      let route = -1, gone = 0;
      return this.data.ticks.map(({ at }, tick) => {
        if (route + 1 < routes.length && routes[route + 1][0] === tick) {
          route += 1;
          gone = 0;
        }
        const here = { route, gone };
        const next = this.at(tick + 1, agent);
        gone += Math.abs(next[0] - at[agent][0]) + Math.abs(next[1] - at[agent][1]);
        return here;
      });
    });
  }

  at(tick, agent) {
    return tick < this.count ? this.data.ticks[tick].at[agent] : this.data.last[agent];
  }

  action(tick, agent) {
    return this.data.actions[this.data.ticks[tick].action[agent]];
  }

  label(clause) {
    return this.data.clauses[clause].label;
  }

  /** What is left of an agent's route, as points [row, column]. */
  wayAhead(tick, agent) {
    const { route, gone } = this.progress[agent][tick];
    const corners = route < 0 ? [] : this.data.routes[agent][route][1];
    let left = gone;
    for (let at = 0; at + 1 < corners.length; at += 1) {
      const [a, b] = [corners[at], corners[at + 1]];
      const length = Math.abs(b[0] - a[0]) + Math.abs(b[1] - a[1]);
      if (left < length) return [this.at(tick, agent), ...corners.slice(at + 1)];
      left -= length;
    }
    return [];
  }

  /** The other agents that the proof of the action speaks of. */
  partners(tick, agent) {
    const node = this.data.nodes[this.data.ticks[tick].why[agent][this.data.ticks[tick].action[agent]]];
    const named = Object.values(node?.b ?? {}).map((name) => this.names.get(name));
    return [...new Set(named.filter((other) => other !== undefined && other !== agent))];
  }

  // ---- The fixed parts of the page ------------------------------------------------------------------------------------------

  fill() {
    const { data } = this;
    $("title").textContent = data.title;
    $("about").textContent =
      `${data.agents.length} agents on ${data.map.name}, ${this.count} ticks, rules ${data.rules} (${data.hash.slice(0, 12)})`;
    $("scrub").max = this.count - 1;
    for (const speed of SPEEDS) $("speed").append(make("option", { value: speed, selected: speed === this.now.speed }, `${speed} /s`));
    for (const action of data.actions) {
      $("legend").append(make("li", {}, make("span", { class: "swatch", style: `background:${COLOURS[action]}` }), action));
    }
    for (let clause = 0; clause < data.counted; clause += 1) {
      const { head, doc, text } = data.clauses[clause];
      const title = (doc || text).split("\n")[0];
      const row = make("tr", { "data-clause": clause, onclick: () => this.choose({ clause: this.now.clause === clause ? -1 : clause }) },
        make("td", {}, String(this.firings[clause].length)),
        make("td", {}, make("span", { class: "swatch", style: `background:${COLOURS[head] ?? "var(--faint)"}` }), head),
        make("td", {}, make("button", { type: "button", title: "show every time it fired" }, title)));
      $("clauses").append(row);
    }
    for (const found of data.deadlocks) {
      const names = found.agents.map((agent) => data.agents[agent].id);
      const chain = names.map((name, at) => `${name} (${this.label(found.clauses[at])})`).join(" → ");
      const lasts = found.until + 10 > data.first + this.count;
      const when = lasts ? `deadlock since tick ${found.since}` : `circle of waits, ticks ${found.since} to ${found.until}`;
      const go = () => this.choose({ tick: Math.min(Math.max(found.since - data.first, 0), this.count - 1), agent: found.agents[0] });
      $("deadlocks").append(make("button", { type: "button", onclick: go, title: "go there" },
        `${when}: ${chain} → ${names[0]}`));
    }
    if (!data.deadlocks.length) $("deadlocks").textContent = "no deadlock";
  }

  listen() {
    const press = (id, act) => $(id).addEventListener("click", act);
    press("play", () => this.play(!this.now.playing));
    press("first", () => this.choose({ tick: 0 }));
    press("back", () => this.step(-1));
    press("on", () => this.step(1));
    press("closer", () => this.zoom(1.4));
    press("farther", () => this.zoom(1 / 1.4));
    press("whole", () => this.showWhole());
    press("follow", () => this.choose({ follow: !this.now.follow }));
    press("help", () => $("keys").showModal());
    press("theme", () => this.turnTheme());
    $("scrub").addEventListener("input", () => this.choose({ tick: Number($("scrub").value) }));
    $("speed").addEventListener("change", () => { this.now.speed = Number($("speed").value); });
    document.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe($("stage"));
    new ResizeObserver(() => this.drawStrip()).observe($("strip-box"));
    window.addEventListener("hashchange", () => { this.readAddress(); this.refresh(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    this.listenToMap();
    const strip = $("strip");
    const seek = (event) => {
      const box = strip.getBoundingClientRect();
      const tick = Math.floor((event.clientX - box.left) / box.width * this.count);
      const agent = Math.floor((event.clientY - box.top) / box.height * this.data.agents.length);
      this.choose({ tick: Math.max(0, Math.min(this.count - 1, tick)), agent: Math.max(0, Math.min(this.data.agents.length - 1, agent)) });
    };
    strip.addEventListener("pointerdown", (event) => { strip.setPointerCapture(event.pointerId); seek(event); });
    strip.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open) return;
    const inField = ["SELECT", "INPUT"].includes(event.target.tagName);
    const onButton = ["BUTTON", "SUMMARY"].includes(event.target.tagName);
    const ten = event.shiftKey ? 10 : 1;
    const agents = this.data.agents.length;
    const speed = (by) => {
      const at = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.now.speed) + by));
      this.now.speed = SPEEDS[at];
      $("speed").value = SPEEDS[at];
    };
    const acts = {
      " ": onButton ? null : () => this.play(!this.now.playing),
      ArrowLeft: inField ? null : () => this.step(-ten),
      ArrowRight: inField ? null : () => this.step(ten),
      Home: () => this.choose({ tick: 0 }),
      End: () => this.choose({ tick: this.count - 1 }),
      "[": () => speed(-1),
      "]": () => speed(1),
      "+": () => this.zoom(1.4),
      "=": () => this.zoom(1.4),
      "-": () => this.zoom(1 / 1.4),
      0: () => this.showWhole(),
      f: () => this.choose({ follow: !this.now.follow }),
      n: () => this.choose({ agent: (this.now.agent + 1) % agents }),
      p: () => this.choose({ agent: (Math.max(this.now.agent, 0) + agents - 1) % agents }),
      ".": () => this.jump(1),
      ",": () => this.jump(-1),
      "?": () => $("keys").showModal(),
      Escape: () => this.choose({ agent: -1, clause: -1 }),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  }

  turnTheme() {
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark")
      && (document.documentElement.dataset.theme === "dark" || (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches));
    document.documentElement.dataset.theme = dark ? "light" : "dark";
    this.recolour();
  }

  recolour() {
    this.drawGround();
    this.drawStrip();
    this.draw();
  }

  isDark() {
    const theme = document.documentElement.dataset.theme;
    return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  }

  // ---- What is chosen -------------------------------------------------------------------------------------------------------

  choose(changes) {
    Object.assign(this.now, { part: 0 }, changes);
    if (this.now.agent < 0) this.now.follow = false;
    if ("tick" in changes && !changes.keep) this.stop();
    this.refresh();
  }

  step(by) {
    this.choose({ tick: Math.max(0, Math.min(this.count - 1, this.now.tick + by)) });
  }

  /** To the next or previous firing of the chosen clause (of the chosen agent, if there is one), else change of its action. */
  jump(by) {
    const { tick, agent, clause } = this.now;
    if (clause >= 0) {
      const all = this.firings[clause];
      const key = ([t, a]) => t * this.data.agents.length + a;
      const here = key([tick, Math.max(agent, 0)]) + (agent < 0 && by > 0 ? -0.5 : 0);
      const found = by > 0 ? all.find((one) => key(one) > here) : all.findLast((one) => key(one) < here);
      if (found) this.choose({ tick: found[0], agent: found[1] });
      return;
    }
    if (agent < 0) return;
    for (let at = tick + by; at >= 0 && at < this.count; at += by) {
      if (this.action(at, agent) !== this.action(tick, agent)) return this.choose({ tick: at });
    }
  }

  play(on) {
    if (on && this.now.tick === this.count - 1) this.now.tick = 0;
    this.now.playing = on;
    this.clock = undefined;
    this.refresh();
    if (on) requestAnimationFrame((time) => this.advance(time));
  }

  stop() {
    this.now.playing = false;
    this.now.part = 0;
  }

  advance(time) {
    if (!this.now.playing) return;
    const passed = this.clock === undefined ? 0 : (time - this.clock) / 1000 * this.now.speed;
    this.clock = time;
    const total = this.now.tick + this.now.part + passed;
    const before = this.now.tick;
    this.now.tick = Math.min(Math.floor(total), this.count - 1);
    this.now.part = total >= this.count ? 1 : total - this.now.tick;
    if (total >= this.count) this.stop();
    if (this.now.tick !== before || !this.now.playing) this.refresh();
    else this.draw();
    requestAnimationFrame((next) => this.advance(next));
  }

  /** `#tick=20&agent=Car_1&clause=S4` */
  readAddress() {
    const wanted = new URLSearchParams(location.hash.slice(1));
    const tick = Number(wanted.get("tick")) - this.data.first;
    if (wanted.has("tick") && Number.isInteger(tick) && tick >= 0 && tick < this.count) this.now.tick = tick;
    if (wanted.has("agent")) this.now.agent = this.names.get(wanted.get("agent")) ?? -1;
    if (wanted.has("clause")) {
      this.now.clause = this.data.clauses.slice(0, this.data.counted).findIndex(({ label }) => label === wanted.get("clause"));
    }
  }

  writeAddress() {
    const wanted = new URLSearchParams({ tick: this.data.first + this.now.tick });
    if (this.now.agent >= 0) wanted.set("agent", this.data.agents[this.now.agent].id);
    if (this.now.clause >= 0) wanted.set("clause", this.label(this.now.clause));
    history.replaceState(null, "", `#${wanted}`);
  }

  refresh() {
    const { tick, playing, follow, clause } = this.now;
    $("scrub").value = tick;
    $("tick").textContent = `tick ${this.data.first + tick}`;
    $("play").textContent = playing ? "❚❚" : "▶";
    $("play").setAttribute("aria-label", playing ? "pause" : "play");
    $("follow").setAttribute("aria-pressed", follow);
    $("follow").disabled = this.now.agent < 0;
    for (const row of $("clauses").rows) row.setAttribute("aria-selected", Number(row.dataset.clause) === clause);
    if (clause !== this.shownClause) {
      this.shownClause = clause;
      this.drawStrip();
    }
    this.fillFilter();
    this.fillAgent();
    this.draw();
    if (!playing) this.writeAddress();
  }

  // ---- The side -------------------------------------------------------------------------------------------------------------

  fillFilter() {
    const { clause, tick, agent } = this.now;
    $("filter").hidden = clause < 0;
    if (clause < 0) return;
    const { label, file, line, text } = this.data.clauses[clause];
    const all = this.firings[clause];
    const at = all.findIndex(([t, a]) => t === tick && a === agent);
    const place = at < 0 ? "" : `${at + 1} of `;
    $("filter").replaceChildren(
      make("div", { class: "card-head" },
        make("strong", {}, label),
        make("span", {}, `fired ${place}${all.length} times`),
        make("button", { type: "button", title: "previous (,)", onclick: () => this.jump(-1) }, "◀"),
        make("button", { type: "button", title: "next (.)", onclick: () => this.jump(1) }, "▶"),
        make("button", { type: "button", onclick: () => this.choose({ clause: -1 }) }, "all clauses")),
      make("pre", {}, text),
      make("div", { class: "clause" }, `${file}:${line}`));
  }

  fillAgent() {
    const { data, now: { tick, agent } } = this;
    // What the reader has opened stays open from tick to tick.
    const open = new Set([...$("agent").querySelectorAll("details[open]")].map((details) => details.dataset.part));
    if (agent < 0) {
      const list = data.agents.map(({ id }, index) => make("li", {}, this.agentLink(index, id), ` ${this.action(tick, index)}`));
      $("agent").replaceChildren(
        make("h2", {}, "Click an agent to see why it does what it does"),
        make("ul", { class: "tree" }, ...list));
      return;
    }
    const { id, kind, concepts, priority } = data.agents[agent];
    const { at, heading, goal, derived, why, action } = data.ticks[tick];
    const done = data.actions[action[agent]];
    const by = this.causes(tick, agent);
    const bits = data.actions.filter((_, index) => derived[agent] >> index & 1);
    const head = make("div", { class: "card-head" },
      make("h2", {}, id),
      make("span", { class: "badge", id: "action", style: `background:${COLOURS[done]}` }, done),
      ...[kind, ...concepts].map((word) => make("span", { class: "chip" }, word)),
      make("button", { type: "button", title: "choose nothing (Esc)", onclick: () => this.choose({ agent: -1 }) }, "×"));
    const direction = heading[agent] < 0 ? "has not moved yet" : `heading ${data.headings[heading[agent]]}`;
    const facts = make("dl", { class: "facts" },
      make("dt", {}, "at"), make("dd", {}, `[${at[agent]}], ${direction}`),
      make("dt", {}, "goal"), make("dd", {}, `[${goal[agent]}]`),
      make("dt", {}, "priority"), make("dd", {}, String(priority)),
      make("dt", {}, "because"), make("dd", {}, by || "no clause asks anything"));
    if (bits.length > 1) facts.append(make("dt", {}, "derived"), make("dd", {}, `${bits.join(", ")}; the first by the configured order is done`));
    const parts = [head, facts, make("h3", {}, `Why ${done}?`), this.tree(why[agent][action[agent]])];
    data.actions.forEach((other, index) => {
      if (other === done || why[agent][index] < 0) return;
      const question = bits.includes(other) ? `${other} was derived too: why?` : `Why not ${other}?`;
      parts.push(this.part(`why-${other}`, question, open, () => [this.tree(why[agent][index])]));
    });
    parts.push(this.part("atoms", "True atoms", open, () => this.atoms(tick, agent)));
    $("agent").replaceChildren(...parts);
  }

  /** A part that is made when it is opened. */
  part(name, title, open, content) {
    const details = make("details", { "data-part": name, open: open.has(name) }, make("summary", {}, title));
    const fill = () => { if (details.open && details.childElementCount === 1) details.append(...content()); };
    details.addEventListener("toggle", fill);
    fill();
    return details;
  }

  /** The clauses that fired for an agent. */
  causes(tick, agent) {
    const titles = this.data.ticks[tick].fired[agent].map((clause) => (this.data.clauses[clause].doc || this.label(clause)).split("\n")[0]);
    return titles.join("; ");
  }

  agentLink(agent, text = this.data.agents[agent].id) {
    const link = make("button", { type: "button", class: "agent-link", onclick: () => this.choose({ agent }) }, text);
    const hover = (which) => () => { this.hover = which; this.draw(); };
    for (const [name, which] of [["mouseenter", agent], ["focus", agent], ["mouseleave", -1], ["blur", -1]]) link.addEventListener(name, hover(which));
    return link;
  }

  /** A text in which the names of agents can be clicked. */
  linked(text) {
    return text.split(/([\w.-]+)/).map((word) => (this.names.has(word) && this.names.get(word) !== this.now.agent ? this.agentLink(this.names.get(word)) : word));
  }

  clauseLink(clause) {
    const { doc, label, file, line, text } = this.data.clauses[clause];
    return make("span", { class: "clause", title: text }, `${(doc || label).split("\n")[0]}  [${file.split(/[\\/]/).pop()}:${line}]`);
  }

  /** The proof of a node, or why it does not hold. What is told once above is not told again below. */
  tree(number) {
    const list = make("ul", { class: "tree" });
    if (number >= 0) list.append(this.branch(number, this.data.nodes[number].t ?? this.data.nodes[number].f, new Set()));
    return list;
  }

  branch(number, text, told) {
    const node = this.data.nodes[number];
    const item = make("li", {});
    if (node.t !== undefined) {
      item.append(make("span", { class: "yes" }, ...this.linked(text)));
      if (node.c === undefined) return item;
      item.append(" by ", this.clauseLink(node.c));
      if (told.has(number)) return item;
      told.add(number);
      item.append(make("ul", {}, ...node.p.map((premise) => this.premise(premise, told))));
      return item;
    }
    item.append(make("span", { class: "no" }, ...this.linked(text)));
    if (node.by === "not-looked-into") item.append(" (not looked into)");
    if (!node.m || told.has(number)) return item;
    told.add(number);
    item.append(this.misses(node.m, told));
    return item;
  }

  /** A literal that holds. */
  premise([text, kind, child], told) {
    if (child < 0) return make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    const node = this.data.nodes[child];
    if (kind !== "not") return this.branch(child, text, told);
    const item = make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    if (node.m && !told.has(child)) {
      told.add(child);
      item.append(make("details", {}, make("summary", {}, "no clause derives it"), this.misses(node.m, told)));
    }
    return item;
  }

  /** For each clause what is in its way. */
  misses(misses, told) {
    return make("ul", {}, ...misses.map(([clause, binding, fails]) => {
      const nearest = Object.entries(binding).filter(([, name]) => this.names.get(name) !== this.now.agent);
      const item = make("li", {}, this.clauseLink(clause));
      if (nearest.length) item.append(" nearest ", ...this.linked(nearest.map(([variable, name]) => `${variable} = ${name}`).join(", ")));
      const failures = fails.map(([text, kind, child]) => {
        const say = kind === "not" ? " fails" : kind === "in-view" ? " is not in view" : kind === "fact" ? " does not hold" : " is not so";
        const failure = make("li", {}, make("span", { class: "no" }, ...this.linked(text)), say);
        const node = child < 0 ? undefined : this.data.nodes[child];
        if (node && (node.c !== undefined || node.m) && !told.has(child)) failure.append(make("ul", {}, this.branch(child, node.t ?? node.f, told)));
        return failure;
      });
      if (!fails.length) failures.push(make("li", {}, "its head does not fit"));
      item.append(make("ul", {}, ...failures));
      return item;
    }));
  }

  /** What is true of an agent and of those it sees, as the rules are given it. */
  atoms(tick, agent) {
    const { predicates, agents } = this.data;
    const rows = this.facts[tick];
    const sees = predicates.findIndex(({ name }) => name === "Sees");
    const seen = new Set([agent]);
    for (let at = 0; at < rows[sees].length; at += 2) if (rows[sees][at] === agent) seen.add(rows[sees][at + 1]);
    const of = new Map([...seen].map((one) => [one, []]));
    predicates.forEach(({ name, arity }, predicate) => {
      const flat = rows[predicate];
      for (let at = 0; at < flat.length; at += arity) {
        const row = flat.slice(at, at + arity);
        if (row.some((one) => !seen.has(one)) || (arity === 2 && row[0] === row[1])) continue;
        of.get(row[0]).push(`${name}(${row.map((one) => agents[one].id).join(", ")})`);
      }
    });
    return [...of].map(([one, atoms]) => make("div", {}, this.agentLink(one), make("p", { class: "atoms" }, ...this.linked(atoms.join(", ")))));
  }

  // ---- The map --------------------------------------------------------------------------------------------------------------

  /** The ground once, at so many pixels a cell that a large city still fits a canvas. */
  drawGround() {
    const { rows, cols, ground, kinds } = this.data.map;
    const dark = this.isDark();
    const [other, walking, traffic, crossing, line, house, office, garage, store, station] = dark
      ? ["#1b2a20", "#4a4d52", "#2c2f34", "#5b5e52", "#c9a400", "#6b4438", "#3d5266", "#55565e", "#6a5a2f", "#6a3550"]
      : ["#cfe0c3", "#e6e2d8", "#a9adb3", "#d4d0b4", "#ffd700", "#c98f78", "#8fa9c2", "#a6a3ad", "#d8bd6d", "#c987a6"];
    const colours = [other, walking, traffic, crossing, line, house, office, garage, store, station];
    const size = Math.max(1, Math.min(8, Math.floor(4096 / Math.max(rows, cols))));
    const canvas = new OffscreenCanvas(cols * size, rows * size);
    const paint = canvas.getContext("2d");
    ground.forEach((runs, row) => {
      let col = 0;
      for (let at = 0; at < runs.length; at += 2) {
        const [kind, length] = [runs[at], runs[at + 1]];
        paint.fillStyle = colours[kind];
        paint.fillRect(col * size, row * size, length * size, size);
        if (kind === 3) {
          paint.fillStyle = dark ? "#85887a" : "#ffffff";
          for (let cell = col; cell < col + length; cell += 1) if ((cell + row) % 2) paint.fillRect(cell * size, row * size, size, size);
        }
        col += length;
      }
    });
    this.ground = { canvas, size };
    this.buildings = this.findBuildings(kinds);
  }

  /** The rectangles of buildings, for their names. */
  findBuildings(kinds) {
    const found = new Map();
    const done = [];
    this.data.map.ground.forEach((runs, row) => {
      let col = 0;
      const here = new Set();
      for (let at = 0; at < runs.length; at += 2) {
        const [kind, length] = [runs[at], runs[at + 1]];
        if (kind >= 5) {
          const key = `${kind} ${col} ${length}`;
          here.add(key);
          if (found.has(key)) found.get(key).rows += 1;
          else found.set(key, { name: kinds[kind], row, col, rows: 1, cols: length });
        }
        col += length;
      }
      for (const [key, building] of found) {
        if (!here.has(key)) {
          done.push(building);
          found.delete(key);
        }
      }
    });
    return [...done, ...found.values()];
  }

  resize() {
    const canvas = $("map");
    const scale = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * scale));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (!this.camera || this.camera.whole) this.showWhole();
    else this.draw();
  }

  showWhole() {
    // What the agents ever reach is the city worth looking at; the rest of the map is there to pan to.
    const cells = this.data.ticks.flatMap(({ at }) => at);
    const spread = (axis, most) => {
      const values = cells.map((cell) => cell[axis]);
      const [low, high] = [values.reduce((a, b) => Math.min(a, b)) - 8, values.reduce((a, b) => Math.max(a, b)) + 8];
      return [Math.max(low, 0), Math.min(high, most)];
    };
    const [top, bottom] = spread(0, this.data.map.rows);
    const [left, right] = spread(1, this.data.map.cols);
    const { width, height } = $("map");
    const scale = Math.min(width / (right - left), height / (bottom - top));
    this.camera = { row: (top + bottom) / 2, col: (left + right) / 2, scale, whole: true };
    this.now.follow = false;
    $("follow").setAttribute("aria-pressed", false);
    this.draw();
  }

  /** Zooms so that the point of the canvas stays where it is. */
  zoom(by, x = $("map").width / 2, y = $("map").height / 2) {
    const { camera } = this;
    const [row, col] = this.cellAt(x, y);
    camera.scale = Math.max(0.5, Math.min(80, camera.scale * by));
    camera.whole = false;
    camera.row = row - (y - $("map").height / 2) / camera.scale;
    camera.col = col - (x - $("map").width / 2) / camera.scale;
    this.draw();
  }

  cellAt(x, y) {
    const { row, col, scale } = this.camera;
    return [row + (y - $("map").height / 2) / scale, col + (x - $("map").width / 2) / scale];
  }

  pixelAt(row, col) {
    const { camera } = this;
    return [(col - camera.col) * camera.scale + $("map").width / 2, (row - camera.row) * camera.scale + $("map").height / 2];
  }

  /** Where an agent is drawn: between its cells while the city moves. */
  place(agent) {
    const { tick, part } = this.now;
    const [from, to] = [this.at(tick, agent), this.at(tick + 1, agent)];
    const share = this.stillMotion ? 0 : part;
    return [from[0] + (to[0] - from[0]) * share + 0.5, from[1] + (to[1] - from[1]) * share + 0.5];
  }

  agentAt(x, y) {
    const near = this.data.agents.map((_, agent) => {
      const [px, py] = this.pixelAt(...this.place(agent));
      return [Math.hypot(px - x, py - y), agent];
    });
    const [distance, agent] = near.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity, -1]);
    return distance < Math.max(3 * this.camera.scale, 14 * (window.devicePixelRatio || 1)) ? agent : -1;
  }

  listenToMap() {
    const canvas = $("map");
    const held = new Map();
    let moved = false;
    const point = (event) => {
      const box = canvas.getBoundingClientRect();
      const scale = canvas.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, point(event));
      moved = held.size > 1;
    });
    canvas.addEventListener("pointermove", (event) => {
      const here = point(event);
      const before = held.get(event.pointerId);
      if (!before) {
        canvas.style.cursor = this.agentAt(...here) < 0 ? "grab" : "pointer";
        return;
      }
      if (!moved && Math.hypot(here[0] - before[0], here[1] - before[1]) < 5) return;
      moved = true;
      const others = [...held].filter(([id]) => id !== event.pointerId);
      held.set(event.pointerId, here);
      if (others.length) {
        const [, [ox, oy]] = others[0];
        const spread = ([x, y]) => Math.hypot(x - ox, y - oy) || 1;
        this.zoom(spread(here) / spread(before), ox, oy);
        return;
      }
      this.camera.row -= (here[1] - before[1]) / this.camera.scale;
      this.camera.col -= (here[0] - before[0]) / this.camera.scale;
      this.camera.whole = false;
      this.now.follow = false;
      $("follow").setAttribute("aria-pressed", false);
      this.draw();
    });
    const release = (event) => {
      if (!held.delete(event.pointerId) || held.size) return;
      if (!moved && event.type === "pointerup") this.choose({ agent: this.agentAt(...point(event)) });
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...point(event));
    }, { passive: false });
  }

  /** Keeps the map in sight: nothing beyond its edges is shown while there is map to show. */
  clamp() {
    const { camera, data: { map } } = this;
    const keep = (at, pixels, cells) => {
      const half = pixels / camera.scale / 2;
      return 2 * half >= cells ? cells / 2 : Math.max(half, Math.min(cells - half, at));
    };
    camera.row = keep(camera.row, $("map").height, map.rows);
    camera.col = keep(camera.col, $("map").width, map.cols);
  }

  draw() {
    if (!this.camera) return;
    const { tick, agent, clause, follow } = this.now;
    if (follow && agent >= 0) [this.camera.row, this.camera.col] = this.place(agent);
    this.clamp();
    const canvas = $("map");
    const paint = canvas.getContext("2d");
    paint.clearRect(0, 0, canvas.width, canvas.height);
    const [x, y] = this.pixelAt(0, 0);
    const { scale } = this.camera;
    paint.imageSmoothingEnabled = scale < this.ground.size;
    paint.drawImage(this.ground.canvas, x, y, this.data.map.cols * scale, this.data.map.rows * scale);
    if (scale > 5) this.nameBuildings(paint);
    if (agent >= 0) this.drawChoice(paint, tick, agent);
    // Who is chosen is drawn last, over the others.
    const order = this.data.agents.map((_, one) => one).filter((one) => one !== agent);
    if (agent >= 0) order.push(agent);
    order.forEach((one) => {
      const fired = clause < 0 || this.data.ticks[tick].fired[one].includes(clause);
      paint.globalAlpha = fired || one === agent ? 1 : 0.35;
      this.drawAgent(paint, one);
      paint.globalAlpha = 1;
    });
    this.drawCursor();
  }

  nameBuildings(paint) {
    const { scale } = this.camera;
    paint.fillStyle = this.isDark() ? "#ffffff90" : "#00000080";
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    paint.font = `${Math.min(1.6 * scale, 22)}px system-ui, sans-serif`;
    for (const { name, row, col, rows, cols } of this.buildings) {
      paint.fillText(name, ...this.pixelAt(row + rows / 2, col + cols / 2));
    }
  }

  /** Field of view, way ahead, goal and partners of the chosen agent. */
  drawChoice(paint, tick, agent) {
    const { view, goal } = this.data.ticks[tick];
    const colour = COLOURS[this.action(tick, agent)];
    const { scale } = this.camera;
    const unit = window.devicePixelRatio || 1;
    const [top, left, bottom, right] = view[agent];
    const [x, y] = this.pixelAt(top, left);
    const size = [(right + 1 - left) * scale, (bottom + 1 - top) * scale];
    paint.fillStyle = this.isDark() ? "#ffffff14" : "#1f5fbf16";
    paint.fillRect(x, y, ...size);
    paint.strokeStyle = this.isDark() ? "#ffffff80" : "#1f5fbf90";
    paint.lineWidth = 1.5 * unit;
    paint.setLineDash([6 * unit, 4 * unit]);
    paint.strokeRect(x, y, ...size);
    paint.setLineDash([]);
    const way = this.wayAhead(tick, agent);
    if (way.length) {
      paint.strokeStyle = colour;
      paint.globalAlpha = 0.55;
      paint.lineWidth = Math.max(2 * unit, 0.6 * scale);
      paint.lineJoin = "round";
      paint.beginPath();
      way.forEach(([row, col], at) => {
        const point = this.pixelAt(row + 0.5, col + 0.5);
        if (at) paint.lineTo(...point);
        else paint.moveTo(...point);
      });
      paint.stroke();
      paint.globalAlpha = 1;
    }
    const [gx, gy] = this.pixelAt(goal[agent][0] + 0.5, goal[agent][1] + 0.5);
    paint.fillStyle = colour;
    paint.beginPath();
    paint.arc(gx, gy, Math.max(4 * unit, scale), 0, 2 * Math.PI);
    paint.fill();
    const here = this.pixelAt(...this.place(agent));
    paint.lineWidth = 2.5 * unit;
    paint.strokeStyle = colour;
    for (const partner of this.partners(tick, agent)) {
      const there = this.pixelAt(...this.place(partner));
      paint.beginPath();
      paint.moveTo(...here);
      paint.lineTo(...there);
      paint.stroke();
      paint.beginPath();
      paint.arc(...there, Math.max(3.4 * scale, 12 * unit), 0, 2 * Math.PI);
      paint.stroke();
    }
  }

  drawAgent(paint, agent) {
    const { kind, concepts, id, icons } = this.data.agents[agent];
    const { tick } = this.now;
    const { scale } = this.camera;
    const unit = window.devicePixelRatio || 1;
    const [x, y] = this.pixelAt(...this.place(agent));
    const heading = this.data.ticks[tick].heading[agent];
    const chosen = agent === this.now.agent || agent === this.hover;
    const car = kind === "Car";
    const side = Math.max((car ? 7 : 5) * scale, (car ? 26 : 20) * unit);
    const colour = COLOURS[this.action(tick, agent)];
    // The action: a disc under the icon with a rim that is seen on any ground.
    paint.beginPath();
    paint.arc(x, y, 0.42 * side, 0, 2 * Math.PI);
    paint.fillStyle = `${colour}70`;
    paint.fill();
    paint.strokeStyle = chosen ? (this.isDark() ? "#fff" : "#000") : colour;
    paint.lineWidth = (chosen ? 3 : 2) * unit;
    paint.stroke();
    paint.save();
    paint.translate(x, y);
    if (car) paint.rotate(TURNS[this.data.headings[heading]] ?? 0);
    paint.imageSmoothingEnabled = true;
    paint.imageSmoothingQuality = "high";
    const icon = this.icons[car ? icons[0] : icons[Math.max(heading, 0)]];
    paint.drawImage(icon, -side / 2, -side / 2, side, side);
    paint.restore();
    if (scale > 5 * unit || chosen) {
      paint.font = `${chosen ? 600 : 400} ${12 * unit}px system-ui, sans-serif`;
      paint.textAlign = "center";
      paint.textBaseline = "top";
      const words = [id, ...concepts].join(" ");
      const [width, below] = [paint.measureText(words).width, y + 0.45 * side];
      paint.fillStyle = this.isDark() ? "#000000b0" : "#ffffffc8";
      paint.fillRect(x - width / 2 - 3 * unit, below - 2 * unit, width + 6 * unit, 16 * unit);
      paint.fillStyle = this.isDark() ? "#fff" : "#000";
      paint.fillText(words, x, below);
    }
  }

  // ---- The strip chart ------------------------------------------------------------------------------------------------------

  /** One pixel for each decision, stretched; the cursor is drawn over a copy of it. */
  drawStrip() {
    const { ticks, agents, actions } = this.data;
    const small = new OffscreenCanvas(this.count, agents.length);
    const paint = small.getContext("2d");
    const image = paint.createImageData(this.count, agents.length);
    const colours = actions.map((action) => [1, 3, 5].map((at) => parseInt(COLOURS[action].slice(at, at + 2), 16)));
    const { clause } = this.now;
    ticks.forEach(({ action, fired }, tick) => {
      for (let agent = 0; agent < agents.length; agent += 1) {
        const at = 4 * (agent * this.count + tick);
        image.data.set(colours[action[agent]], at);
        image.data[at + 3] = clause < 0 || fired[agent].includes(clause) ? 255 : 40;
      }
    });
    paint.putImageData(image, 0, 0);
    const strip = $("strip");
    const unit = window.devicePixelRatio || 1;
    const row = Math.max(3, Math.min(12, Math.floor(170 / agents.length)));
    strip.style.height = `${row * agents.length}px`;
    strip.width = Math.max(1, Math.round($("strip-box").clientWidth * unit));
    strip.height = Math.max(1, row * agents.length * unit);
    const whole = new OffscreenCanvas(strip.width, strip.height);
    const large = whole.getContext("2d");
    large.imageSmoothingEnabled = false;
    large.drawImage(small, 0, 0, strip.width, strip.height);
    large.fillStyle = this.isDark() ? "#16181c" : "#f6f5f1";
    for (let agent = 1; agent < agents.length; agent += 1) large.fillRect(0, agent * row * unit, strip.width, unit);
    large.strokeStyle = this.isDark() ? "#ffffff" : "#000000";
    large.lineWidth = 2 * unit;
    for (const { agents: held, since, until } of this.data.deadlocks) {
      for (const agent of held) {
        const x = (since - this.data.first) / this.count * strip.width;
        const width = Math.max((until + 1 - since) / this.count * strip.width, 2 * unit);
        large.strokeRect(x, agent * row * unit + unit, width - unit, row * unit - unit);
      }
    }
    this.strip = whole;
    this.drawCursor();
  }

  drawCursor() {
    const strip = $("strip");
    if (!this.strip) return;
    const paint = strip.getContext("2d");
    const unit = window.devicePixelRatio || 1;
    paint.clearRect(0, 0, strip.width, strip.height);
    paint.drawImage(this.strip, 0, 0);
    const width = strip.width / this.count;
    const x = (this.now.tick + this.now.part) * width;
    paint.fillStyle = this.isDark() ? "#ffffff" : "#000000";
    paint.fillRect(x + (width - 2 * unit) / 2, 0, 2 * unit, strip.height);
    if (this.now.agent >= 0) {
      const row = strip.height / this.data.agents.length;
      paint.strokeStyle = paint.fillStyle;
      paint.lineWidth = 1.5 * unit;
      paint.strokeRect(0, this.now.agent * row, strip.width, row);
    }
  }
}
