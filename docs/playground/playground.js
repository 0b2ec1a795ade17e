// The playground: rules in an editor, and a city that runs under them in a worker.

const PACES = [1, 2, 5, 10, 20, 50];

/** The time from the last key to the check of the rules, in milliseconds. */
const PAUSE = 250;

/** The time after which a worker counts as stuck, in milliseconds. Its own limit is shorter. */
const STUCK = 15_000;

/** The maximum number of characters of rules in a link or in the editor. */
const RULES_MAX = 200_000;

/** The library reported diagnostics. */
class Rejected extends Error {
  constructor(report) {
    super(report.diagnostics.map(({ message }) => message).join("; "));
    this.report = report;
  }
}

/** A worker with the library. After a defect or a long silence it restarts, without a city. */
class Service {
  constructor() {
    this.last = 0;
    /** Whether a worker has answered: the library can be loaded. */
    this.answered = false;
    this.start();
  }

  start() {
    this.worker?.terminate();
    this.waiting = new Map();
    this.worker = new Worker("worker.js", { type: "module" });
    this.worker.onmessage = ({ data }) => this.settle(data);
    const missing = "the library cannot be loaded; reload the page, or use another browser";
    this.worker.onerror = (event) => this.fail(event.message || missing);
  }

  settle({ id, result, report, fault }) {
    const call = this.waiting.get(id);
    if (!call) return;
    if (fault) return this.fail(fault);
    this.answered = true;
    this.waiting.delete(id);
    clearTimeout(call.timer);
    if (report) call.reject(new Rejected(report));
    else call.resolve(result);
  }

  /** Rejects all calls and restarts, unless no worker has ever answered: another one would not, either. */
  fail(message) {
    const calls = [...this.waiting.values()];
    if (this.answered) this.start();
    else this.worker.terminate();
    for (const { timer, reject } of calls) {
      clearTimeout(timer);
      reject(new Error(message));
    }
  }

  /** Returns the result of a call of the library. */
  call(name, ...args) {
    this.last += 1;
    const id = this.last;
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.fail(`no answer in ${STUCK / 1000} s`), STUCK);
      this.waiting.set(id, { resolve, reject, timer });
      this.worker.postMessage({ id, call: name, args });
    });
  }
}

/** A run that grows. It keeps as many ticks as the worker, and the explanations of one agent. */
class LiveRun extends Run {
  constructor(data, now) {
    super(data);
    this.now = now;
    this.ticks = [];
    /** The number of ticks that are no longer kept. */
    this.dropped = 0;
    this.explanations = new Map();
  }

  get count() {
    return this.dropped + this.ticks.length;
  }

  /** Adds a tick. `ways` has the rest of the route of agents with a new route. */
  add(tick) {
    const before = this.ticks.at(-1);
    const far = ([row, col], [toRow, toCol]) => Math.abs(toRow - row) + Math.abs(toCol - col);
    tick.progress = tick.ways.map((corners, agent) =>
      corners
        ? { corners, gone: 0 }
        : {
            corners: before.progress[agent].corners,
            gone: before.progress[agent].gone + far(before.at[agent], before.next[agent]),
          },
    );
    this.ticks.push(tick);
    if (this.ticks.length > this.data.kept) {
      this.ticks.shift();
      this.explanations.delete(this.dropped);
      this.dropped += 1;
    }
  }

  /** Adds explanations; those of another agent are dropped. */
  explain(explanations) {
    for (const explanation of explanations)
      if (explanation) this.explanations.set(explanation.tick - this.data.first, explanation);
  }

  /** Returns the entry of a tick; after the last tick, that of the last one. */
  of(tick) {
    return this.ticks[Math.max(0, Math.min(tick - this.dropped, this.ticks.length - 1))];
  }

  at(tick, agent) {
    return tick < this.count ? this.of(tick).at[agent] : this.of(tick).next[agent];
  }

  goal(tick, agent) {
    return this.of(tick).goal[agent];
  }

  act(tick, agent) {
    return this.of(tick).action[agent];
  }

  heading(tick, agent) {
    return this.data.headings[this.of(tick).heading[agent]];
  }

  bits(tick, agent) {
    return this.of(tick).derived[agent];
  }

  fired(tick, agent) {
    return this.of(tick).fired[agent];
  }

  box(tick, agent) {
    return this.of(tick).view[agent];
  }

  progress(tick, agent) {
    return this.of(tick).progress[agent];
  }

  /** Returns the explanation of a tick, if it is that of the agent. */
  explanation(tick, agent) {
    const found = this.explanations.get(tick);
    return found?.agent === agent ? found : undefined;
  }

  isExplained(tick, agent) {
    return this.explanation(tick, agent) !== undefined;
  }

  node(tick, agent, action) {
    return this.explanation(tick, agent)?.why[action] ?? -1;
  }

  /** The nodes of the explanation that the page shows: each tick has its own. */
  get nodes() {
    return this.explanation(this.now.tick, this.now.agent)?.nodes ?? [];
  }

  rows(tick) {
    const rows = this.explanations.get(tick)?.rows ?? [];
    return this.data.predicates.map((_, predicate) => new Set(rows[predicate]));
  }

  values(tick) {
    return this.explanations.get(tick)?.values ?? [];
  }

  /** Returns the rectangle of the agents and of their routes at the start. */
  bounds() {
    const bounds = [Infinity, Infinity, -Infinity, -Infinity];
    const { at, progress } = this.ticks[0];
    for (const cell of [...at, ...progress.flatMap(({ corners }) => corners)]) extend(bounds, cell);
    return bounds;
  }
}

/** The editor: a text area over a colored copy of its text. */
class Editor {
  constructor(edited) {
    this.area = $("text");
    this.marks = [];
    this.draw();
    this.area.addEventListener("input", () => {
      this.marks = [];
      this.draw();
      edited();
    });
    this.area.addEventListener("scroll", () => this.follow());
    new ResizeObserver(() => this.keepCaret()).observe(this.area);
    this.area.addEventListener("keydown", (event) => this.indent(event));
    this.area.maxLength = RULES_MAX;
  }

  get text() {
    return this.area.value;
  }

  set text(text) {
    this.area.value = text;
    this.area.setSelectionRange(0, 0);
    this.area.scrollTo(0, 0);
    this.marks = [];
    this.draw();
  }

  /** Tab indents; Escape, then Tab, leaves the editor. */
  indent(event) {
    if (event.key === "Escape") this.leaves = true;
    else if (event.key !== "Tab") this.leaves = false;
    if (event.key !== "Tab" || event.shiftKey || this.leaves) return;
    event.preventDefault();
    const { selectionStart, selectionEnd } = this.area;
    this.area.setRangeText("    ", selectionStart, selectionEnd, "end");
    this.area.dispatchEvent(new Event("input"));
  }

  follow() {
    for (const layer of [$("colors"), $("marks")]) layer.scrollTop = this.area.scrollTop;
  }

  /** Keeps the line of the caret in view when the editor becomes smaller. */
  keepCaret() {
    const { area, text } = this;
    const line = $("colors").children[text.slice(0, area.selectionEnd).split("\n").length - 1];
    const bottom = line.offsetTop + 2 * line.offsetHeight;
    if (document.activeElement === area) area.scrollTop = Math.max(area.scrollTop, bottom - area.clientHeight);
    this.follow();
  }

  /** Returns the offset of a line and a column, which count characters from 1. */
  offset(line, column) {
    const lines = this.text.split("\n");
    const before = lines.slice(0, line - 1).reduce((sum, one) => sum + one.length + 1, 0);
    return before + [...(lines[line - 1] ?? "")].slice(0, column - 1).join("").length;
  }

  /** Underlines the places of diagnostics. */
  show(diagnostics) {
    this.marks = diagnostics.flatMap(({ severity, labels }) => {
      const label = labels.find(({ file, primary }) => primary && file === "rules.dl");
      if (!label) return [];
      const start = this.offset(label.line, label.column);
      const end = Math.max(this.offset(label.end_line, label.end_column), start + 1);
      return [{ start, end, severity, line: label.line }];
    });
    this.draw();
  }

  /** Selects a place and scrolls to it. */
  go({ start, end, line }) {
    this.area.focus();
    this.area.setSelectionRange(start, end);
    this.area.scrollTop = Math.max(0, $("colors").children[line - 1].offsetTop - this.area.clientHeight / 3);
  }

  draw() {
    const { text, marks } = this;
    const lines = colored(text);
    for (const { line, severity } of marks.toSorted((a, b) => (a.severity === "error") - (b.severity === "error")))
      lines[line - 1].className = `line ${severity}`;
    $("colors").replaceChildren(...lines);
    let at = 0;
    const underlined = [];
    for (const { start, end, severity } of marks.toSorted((a, b) => a.start - b.start || b.end - a.end)) {
      if (start < at) continue;
      // A mark at the end of a line covers a space, so that it can be seen.
      const covered = text.slice(start, end);
      underlined.push(
        text.slice(at, start),
        make("span", { class: severity }, covered.trim() ? covered : ` ${covered}`),
      );
      at = end;
    }
    $("marks").replaceChildren(...underlined, text.slice(at), "\n");
    this.follow();
  }
}

/** The tokens of rules, with the classes of their colors. */
const TOKENS = new RegExp(
  [
    String.raw`(?<comment>//[^\n]*|/\*[\s\S]*?(?:\*/|$))`,
    String.raw`(?<text>"(?:[^"\\\n]|\\.)*"?)`,
    String.raw`(?<directive>^\s*\.\w+)`,
    String.raw`(?<word>\b(?:Not|count|sum|min|max|mean)\b|:-|!)`,
    String.raw`(?<temporal>\b(?:previous|once|since)(?=\s*\[|\s+\w+\()|\b(?:historically|for)(?=\s*\[))`,
    String.raw`(?<action>\b(?:Slow|Normal|Fast|Stop)\b)`,
    String.raw`(?<name>\b\w+(?=\())`,
  ].join("|"),
  "gm",
);

/** Returns the lines of a text as elements with colored spans. */
function colored(text) {
  const lines = [make("div", { class: "line" })];
  const add = (part, kind) =>
    part.split("\n").forEach((piece, at) => {
      if (at) lines.push(make("div", { class: "line" }));
      if (piece) lines.at(-1).append(kind ? make("span", { class: kind }, piece) : piece);
    });
  let at = 0;
  for (const match of text.matchAll(TOKENS)) {
    const [kind] = Object.entries(match.groups).find(([, found]) => found !== undefined);
    add(text.slice(at, match.index));
    add(match[0], kind);
    at = match.index + match[0].length;
  }
  add(text.slice(at));
  return lines;
}

/** Compresses a text for a link. */
async function compressed(text) {
  const stream = new Blob([text]).stream().pipeThrough(new CompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const letters = Array.from(bytes, (byte) => String.fromCharCode(byte)).join("");
  return btoa(letters).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

/** Returns the text of a link; throws an error for a damaged or too long one. */
async function restored(packed) {
  const letters = packed.replaceAll("-", "+").replaceAll("_", "/");
  const stream = new Blob([bytesOf(letters)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const reader = stream.pipeThrough(new TextDecoderStream("utf-8", { fatal: true })).getReader();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return text;
    text += value;
    if (text.length > RULES_MAX) throw new Error(`the rules have more than ${RULES_MAX} characters`);
  }
}

class Playground extends Viewer {
  constructor(scenery, run, { engine, checker, modes }) {
    super(scenery, [run]);
    run.now = this.now;
    Object.assign(this, { engine, checker, modes });
    this.editor = new Editor(() => this.edited());
    /** The number of the last edit; results of earlier ones are dropped. */
    this.edit = 0;
    /** Changes of the rules, one after the other. */
    this.changes = Promise.resolve();
    /** The last tick that the page has shown. */
    this.reached = 0;
    this.isFetching = false;
    this.addPanes();
    this.describeControls(PACES);
    this.listen();
  }

  listen() {
    this.listenToTools();
    this.press("play", () => this.play(!this.now.playing));
    this.press("back", () => this.step(-1));
    this.press("on", () => this.step(1));
    this.press("reset", () => this.reset());
    this.press("copy", () => this.copyLink());
    $("scrub").addEventListener("input", () => this.choose({ tick: Number($("scrub").value) }));
    $("mode").addEventListener("change", () => this.startFrom($("mode").value));
    $("seed").addEventListener("change", () => this.reset());
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => location.hash !== this.address && location.reload());
    this.showTab("edit");
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (["TEXTAREA", "INPUT", "SELECT"].includes(event.target.tagName)) return;
    const onButton = ["BUTTON", "SUMMARY"].includes(event.target.tagName);
    this.useKey(event, {
      ...this.keys(),
      " ": onButton ? null : () => this.play(!this.now.playing),
      ArrowLeft: () => this.step(-1),
      ArrowRight: () => this.step(1),
    });
  }

  /** The rules of the chosen mode. */
  get original() {
    return this.modes.find(({ name }) => name === this.mode).rules;
  }

  /** Calls the worker to begin or change a run. Meanwhile the page asks for no ticks of the present one. */
  async change(name, ...args) {
    this.isChanging = true;
    try {
      return await this.engine.call(name, ...args);
    } catch (error) {
      this.isChanging = false;
      throw error;
    }
  }

  /** Begins a run, and shows its first tick. Throws an error if there is none. */
  async begin(mode, rules, seed) {
    const { header, scenery } = await this.change("begin", mode, rules, seed);
    await this.show(header, await sceneryOf(scenery));
    Object.assign(this, { mode, seed, good: rules, region: undefined });
    this.fit(this.fitsMap);
  }

  /** Shows a run from its first tick on. */
  async show(header, scenery = this.scenery) {
    const run = new LiveRun(header, this.now);
    try {
      await this.fetch(run, 4);
    } finally {
      this.isChanging = false;
    }
    if (!run.count) return;
    this.scenery = scenery;
    const { rows, cols } = scenery.ground.map;
    Object.assign(this.camera, { rows, cols });
    this.runs = [run];
    this.run = run;
    for (const part of [...this.panels, ...this.maps]) Object.assign(part, { run, scenery, data: run.data });
    for (const map of this.maps) map.forgetGround();
    this.explainZones();
    if (this.now.agent >= run.agents) this.now.agent = -1;
    Object.assign(this.now, { tick: 0, part: 0 });
    this.reached = 0;
    this.refresh();
  }

  /** Gets the next ticks of a run from the worker. */
  async fetch(run, count) {
    const { agent } = this.now;
    const { ticks, report } = await this.engine.call("ticks", count, agent);
    for (const { tick, explanation } of ticks) {
      run.add(tick);
      run.explain([explanation]);
    }
    if (report && !ticks.length) this.halt(report);
  }

  /** Stops the city, since the rules fail in its state. */
  halt(report) {
    this.now.playing = false;
    this.isHalted = true;
    this.showReport(report, "The rules fail in this tick of the city. Change them, or reset the run.");
    this.refresh();
  }

  /** Keeps some ticks ahead of the one that is shown. */
  async stock() {
    const { run } = this;
    const ahead = Math.max(4, this.now.speed / 2);
    if (this.isFetching || this.isChanging || this.isHalted || run.count - this.now.tick > ahead) return;
    this.isFetching = true;
    try {
      await this.fetch(run, ahead);
    } catch (error) {
      this.recover(error);
    } finally {
      this.isFetching = false;
    }
  }

  /** Begins again with the last good rules after a defect of the engine. */
  async recover(error) {
    if (this.isRecovering) return;
    this.isRecovering = true;
    this.now.agent = -1;
    this.notify(`The engine stopped: ${error.message}. The city begins again with the last rules that worked.`);
    try {
      await this.begin(this.mode, this.good, this.seed).catch(() => this.begin(this.mode, this.original, this.seed));
    } catch (again) {
      showFault(again);
    } finally {
      this.isRecovering = false;
    }
  }

  /** Gets explanations of the shown tick, and of those ahead, for the chosen agent. */
  async askWhy() {
    const {
      run,
      now: { tick, agent },
    } = this;
    if (agent < 0 || run.isExplained(tick, agent)) return;
    const key = `${tick} ${agent}`;
    if (this.asked === key) return;
    this.asked = key;
    const missing = [];
    for (let at = tick; at < Math.min(run.count, tick + 50); at += 1)
      if (!run.isExplained(at, agent)) missing.push(run.data.first + at);
    try {
      const explanations = await this.engine.call("explain", missing, agent);
      if (this.run !== run || this.now.agent !== agent) return;
      run.explain(explanations);
      if (explanations[0]?.isCut) this.notify("This explanation takes too many steps.");
      this.refresh();
    } catch (error) {
      this.recover(error);
    } finally {
      this.asked = undefined;
    }
  }

  choose(changes) {
    this.notify("");
    Object.assign(this.now, { part: 0 }, changes);
    if (this.now.agent < 0) this.now.follow = false;
    if ("tick" in changes) this.now.playing = false;
    if ("agent" in changes && changes.agent >= 0) this.showTab("why");
    this.refresh();
  }

  async step(by) {
    this.now.playing = false;
    await this.stock();
    const { run } = this;
    this.choose({ tick: Math.max(run.dropped, Math.min(run.count - 1, this.now.tick + by)) });
  }

  play(on) {
    if (on && this.isHalted) return;
    this.now.playing = on;
    this.clock = undefined;
    this.refresh();
    if (on) requestAnimationFrame((time) => this.advance(time));
  }

  advance(time) {
    const { now, run } = this;
    if (!now.playing) return;
    const passed = this.clock === undefined ? 0 : ((time - this.clock) / 1000) * now.speed;
    this.clock = time;
    // A hidden page, or a slow worker, lets the city wait.
    const total = Math.min(now.tick + now.part + Math.min(passed, 3), run.count - 0.001);
    const before = now.tick;
    now.tick = Math.floor(total);
    now.part = total - now.tick;
    if (now.tick !== before) this.refresh();
    else this.draw();
    this.stock();
    requestAnimationFrame((next) => this.advance(next));
  }

  refresh() {
    const { now, run } = this;
    now.tick = Math.max(now.tick, run.dropped);
    this.reached = Math.max(this.reached, now.tick);
    Object.assign($("scrub"), { min: run.dropped, max: this.reached, value: now.tick });
    $("tick").textContent = `tick ${run.data.first + now.tick}`;
    this.refreshControls();
    for (const panel of this.panels) panel.fill();
    this.draw();
    this.askWhy();
    this.stock();
  }

  /** Follows an edit: checks the rules after a pause, and lets the city run under them if they are right. */
  edited() {
    this.edit += 1;
    clearTimeout(this.timer);
    this.state("", "checking …");
    this.timer = setTimeout(() => this.apply(), PAUSE);
  }

  /** Performs a change after those before it. */
  enqueue(work) {
    this.changes = this.changes.then(work).catch((error) => this.recover(error));
    return this.changes;
  }

  /** Checks the rules, and continues the run at the shown tick under them if they are right. */
  apply() {
    const { edit } = this;
    const { text } = this.editor;
    this.writeAddress();
    return this.enqueue(async () => {
      if (edit !== this.edit) return;
      try {
        if (text !== this.good || this.isHalted) {
          const { header } = await this.change("change", text, this.run.data.first + this.now.tick);
          this.good = text;
          this.isHalted = false;
          await this.show(header);
        }
      } catch (error) {
        if (!(error instanceof Rejected)) throw error;
        if (edit === this.edit) this.showReport(error.report);
        return;
      }
      this.check(edit, text);
    });
  }

  /** Shows all diagnostics of the rules, also those that take longer to find. */
  async check(edit, text) {
    try {
      const report = await this.checker.call("check", this.mode, text);
      if (edit === this.edit && !this.isHalted) this.showReport(report);
    } catch (error) {
      if (edit === this.edit) this.notify(`The rules cannot be checked: ${error.message}.`);
    }
  }

  /** Shows the state of the rules. */
  state(kind, words) {
    $("status").className = kind;
    $("status").textContent = words;
  }

  /** Shows diagnostics as the command line prints them, and underlines their places. */
  showReport({ ok, diagnostics, rendered }, words) {
    const errors = diagnostics.filter(({ severity }) => severity === "error").length;
    const warnings = diagnostics.length - errors;
    const count = (number, what) => `${number} ${what}${number === 1 ? "" : "s"}`;
    if (!ok) this.state("bad", `${count(errors, "error")}. ${words ?? "The city keeps the last rules that worked."}`);
    else if (warnings) this.state("warned", `${count(warnings, "warning")}. The city runs under these rules.`);
    else this.state("good", "No faults. The city runs under these rules from this tick on.");
    this.editor.show(diagnostics);
    const parts = diagnostics.map(({ severity, labels }, at) =>
      make(
        "button",
        { type: "button", class: severity, title: "go to this place", onclick: () => this.goTo(labels) },
        make("pre", {}, rendered[at].trimEnd()),
      ),
    );
    $("faults").replaceChildren(...parts);
  }

  goTo(labels) {
    const label = labels.find(({ file }) => file === "rules.dl");
    if (!label) return;
    const { line, column, end_line, end_column } = label;
    this.editor.go({
      start: this.editor.offset(line, column),
      end: this.editor.offset(end_line, end_column),
      line,
    });
  }

  /** Returns the seed in the field, or the present one with a notice if it is none. */
  readSeed() {
    const text = $("seed").value.trim();
    if (isSeed(text)) return text;
    this.notify(`\`${text}\` is not a seed: write a whole number from 0 to 18446744073709551615.`);
    $("seed").value = this.seed;
    return this.seed;
  }

  /** Starts the run again with the rules in the editor; if they have errors, with the last rules that worked. */
  reset() {
    this.notify("");
    clearTimeout(this.timer);
    const seed = this.readSeed();
    const { edit, mode } = this;
    const { text } = this.editor;
    return this.enqueue(async () => {
      this.isHalted = false;
      try {
        await this.begin(mode, text, seed);
        this.check(edit, text);
      } catch (error) {
        if (!(error instanceof Rejected)) throw error;
        this.showReport(error.report);
        await this.begin(mode, text === this.good ? this.original : this.good, seed);
      }
      this.writeAddress();
    });
  }

  /** Loads rules and agents of a mode. */
  async startFrom(mode) {
    const { text } = this.editor;
    const before = text === this.original ? null : { text, mode: this.mode };
    this.edit += 1;
    clearTimeout(this.timer);
    this.mode = mode;
    this.editor.text = this.original;
    await this.reset();
    if (!before) return;
    const back = async () => {
      $("mode").value = before.mode;
      this.mode = before.mode;
      this.editor.text = before.text;
      await this.reset();
    };
    this.notify(`Loaded the rules of ${mode}.`);
    $("notice").append(make("button", { type: "button", onclick: back }, "Bring back my rules"));
  }

  async writeAddress() {
    const { mode, seed, edit } = this;
    const { text } = this.editor;
    const wanted = new URLSearchParams({ mode, seed });
    if (text !== this.original) wanted.set("rules", await compressed(text));
    if (edit !== this.edit) return;
    this.address = `#${wanted}`;
    history.replaceState(null, "", this.address);
  }

  /** Copies the address of the rules, the mode and the seed. */
  async copyLink() {
    await this.writeAddress();
    try {
      await navigator.clipboard.writeText(location.href);
      this.notify("Copied the link to these rules.");
    } catch {
      this.notify(`Copy the link from here: ${location.href}`);
    }
  }
}

function isSeed(text) {
  return /^\d{1,20}$/.test(text) && BigInt(text) < 1n << 64n;
}

/** Reads an address such as `#mode=hard&seed=3&rules=...`, and lists what is wrong with it. */
async function readAddress(modes) {
  const wanted = new URLSearchParams(location.hash.slice(1));
  const faults = [];
  let mode = wanted.get("mode") ?? "expert";
  if (!modes.some(({ name }) => name === mode)) {
    faults.push(`no mode ${mode}`);
    mode = "expert";
  }
  let seed = wanted.get("seed") ?? "0";
  if (!isSeed(seed)) {
    faults.push(`no seed ${seed}`);
    seed = "0";
  }
  let { rules } = modes.find(({ name }) => name === mode);
  if (wanted.has("rules")) {
    try {
      rules = await restored(wanted.get("rules"));
    } catch (error) {
      faults.push(`the rules in the link are damaged (${error.message})`);
    }
  }
  return { mode, seed, rules, faults };
}

async function main() {
  requireBrowser();
  const [engine, checker] = [new Service(), new Service()];
  const modes = await engine.call("modes");
  for (const { name, about } of modes) $("mode").append(make("option", { value: name, title: about }, name));
  const { mode, seed, rules, faults } = await readAddress(modes);
  const original = modes.find(({ name }) => name === mode).rules;
  // A link may contain rules with errors. The city then runs under those of the mode.
  const first = await engine.call("begin", mode, original, seed);
  const scenery = await sceneryOf(first.scenery);
  const run = new LiveRun(first.header);
  run.add((await engine.call("ticks", 1, -1)).ticks[0].tick);
  const page = new Playground(scenery, run, { engine, checker, modes });
  Object.assign(page, { mode, seed, good: original });
  $("mode").value = mode;
  $("seed").value = seed;
  page.editor.text = rules;
  page.resize();
  page.refresh();
  await page.apply();
  if (faults.length) page.notify(`Not found: ${faults.join("; ")}.`);
  page.play(!page.maps[0].stillMotion);
  $("loading").hidden = true;
  performance.mark("loaded");
}

main().catch(showFault);
