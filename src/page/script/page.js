// The state of the page, and the controls that change it.

const SPEEDS = [1, 2, 5, 10, 20, 50];

class Page extends Viewer {
  /** Shows one run, or two runs with their differences. */
  constructor(scenery, runs, pair) {
    super(scenery, runs);
    if (pair) {
      for (const one of runs) one.count = pair.count;
      addSecondPane();
      document.documentElement.classList.add("pair");
      this.difference = new Differences(this, pair);
    }
    this.describe();
    this.summaries = runs.map((one, number) => new Summary(one, this, number));
    this.addPanes();
    this.finder = new Finder(this);
    this.chart = new Chart(this);
    this.splits = ["below", "side"].map((name) => new Split(name));
    this.figure = new Figure(this);
    this.listen();
    this.readAddress();
    this.resize();
    this.refresh();
  }

  /** Fills in title, legend and speeds. */
  describe() {
    const {
      difference,
      run,
      run: { data },
      scenery: {
        ground: { map },
      },
    } = this;
    const rules = (one) => `${one.data.rules} (${one.data.hash.slice(0, 12)})`;
    const size = `${run.agents} agents on ${map.name}, ${run.count} ticks`;
    $("title").textContent = difference ? difference.names.join(" | ") : data.title;
    $("about").textContent = difference
      ? `${data.title} | ${this.runs[1].data.title}; ${size}; rules ${this.runs.map(rules).join(" | ")}`
      : `${size}, rules ${rules(run)}`;
    $("scrub").max = run.count - 1;
    difference?.names.forEach((name, number) => {
      const label = $(paneId("run-name", number));
      label.hidden = false;
      const { rules, seed } = this.runs[number].data;
      label.replaceChildren(make("strong", {}, name), ` ${fileName(rules)}, seed ${seed}`);
    });
    this.describeControls(SPEEDS);
    if (this.runs.some((one) => one.data.driven))
      this.explainColor("driven", make("span", { class: "swatch driven" }));
    if (difference) {
      this.explainColor("differs", make("span", { class: "swatch ring" }));
      this.explainColor("elsewhere", make("span", { class: "swatch ring dotted" }));
    }
    const embedded = new URLSearchParams(location.search).has("embed");
    document.documentElement.classList.toggle("embed", embedded);
    $("open").hidden = !embedded;
  }

  listen() {
    this.listenToTools();
    this.press("play", () => this.play(!this.now.playing));
    this.press("first", () => this.choose({ tick: 0 }));
    this.press("back", () => this.step(-1));
    this.press("on", () => this.step(1));
    this.press("help", () => $("keys").showModal());
    this.press("copy", () => this.copyLink());
    this.press("next-difference", () => this.difference?.jump(1));
    $("scrub").addEventListener("input", () => this.choose({ tick: Number($("scrub").value) }));
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => {
      this.readAddress();
      this.refresh();
    });
    this.showTab("why");
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open) return;
    if (event.target.type === "search") return;
    const inField = ["SELECT", "INPUT"].includes(event.target.tagName);
    const onButton = ["BUTTON", "SUMMARY"].includes(event.target.tagName);
    const ten = event.shiftKey ? 10 : 1;
    const speed = (by) => {
      const at = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.now.speed) + by));
      this.now.speed = SPEEDS[at];
      $("speed").value = SPEEDS[at];
    };
    const acts = {
      ...this.keys(),
      " ": onButton ? null : () => this.play(!this.now.playing),
      ArrowLeft: inField ? null : () => this.step(-ten),
      ArrowRight: inField ? null : () => this.step(ten),
      Home: () => this.choose({ tick: 0 }),
      End: () => this.choose({ tick: this.run.count - 1 }),
      "[": () => speed(-1),
      "]": () => speed(1),
      d: this.difference ? () => this.difference.jump(event.shiftKey ? -1 : 1) : null,
      ".": () => this.jump(1),
      ",": () => this.jump(-1),
      "?": () => $("keys").showModal(),
      "/": () => this.find(),
    };
    this.useKey(event, acts);
  }

  /** Goes to the fields of the filter. */
  find() {
    this.showTab("time");
    $("find-name").focus();
  }

  draw() {
    super.draw();
    this.chart.drawCursor();
  }

  recolor() {
    this.chart.draw();
    super.recolor();
  }

  /** Copies the address of this tick, agent and clause. */
  async copyLink() {
    this.writeAddress();
    try {
      await navigator.clipboard.writeText(location.href);
      this.notify("Copied the link to this tick.");
    } catch {
      this.notify(`Copy the link from here: ${location.href}`);
    }
  }

  choose(changes) {
    this.notify("");
    Object.assign(this.now, { part: 0 }, changes);
    if (this.now.agent < 0) this.now.follow = false;
    if ("tick" in changes) this.stop();
    this.refresh();
  }

  step(by) {
    this.choose({ tick: Math.max(0, Math.min(this.run.count - 1, this.now.tick + by)) });
  }

  /** Goes to the next or previous firing of the chosen clause, or change of the chosen agent's action. */
  jump(by) {
    const { tick, agent, clause, of } = this.now;
    if (clause >= 0) {
      const all = this.runs[of].firingsOf(clause);
      const key = ([t, a]) => t * this.run.agents + a;
      const here = key([tick, Math.max(agent, 0)]) + (agent < 0 && by > 0 ? -0.5 : 0);
      const found = by > 0 ? all.find((one) => key(one) > here) : all.findLast((one) => key(one) < here);
      if (found) this.choose({ tick: found[0], agent: found[1] });
      return;
    }
    if (agent < 0) return;
    for (let at = tick + by; at >= 0 && at < this.run.count; at += by) {
      if (this.runs.some((run) => run.act(at, agent) !== run.act(tick, agent))) return this.choose({ tick: at });
    }
  }

  play(on) {
    this.notify("");
    if (on && this.now.tick === this.run.count - 1) this.now.tick = 0;
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
    const passed = this.clock === undefined ? 0 : ((time - this.clock) / 1000) * this.now.speed;
    this.clock = time;
    const total = this.now.tick + this.now.part + passed;
    const before = this.now.tick;
    this.now.tick = Math.min(Math.floor(total), this.run.count - 1);
    this.now.part = total >= this.run.count ? 1 : total - this.now.tick;
    if (total >= this.run.count) this.stop();
    if (this.now.tick !== before || !this.now.playing) this.refresh();
    else this.draw();
    requestAnimationFrame((next) => this.advance(next));
  }

  /** Reads an address such as `#tick=20&agent=Car_1&clause=S4`, and reports values that do not exist. `run=2` means
   *  that the clause is one of the second run. */
  readAddress() {
    const wanted = new URLSearchParams(location.hash.slice(1));
    this.now.of = wanted.get("run") === "2" && this.runs[1] ? 1 : 0;
    const {
      run,
      run: {
        data: { first },
      },
    } = this;
    const { clauses, counted } = this.runs[this.now.of].data;
    const missing = [];
    const look = (name, position, what) => {
      if (!wanted.has(name)) return;
      const found = position(wanted.get(name));
      if (found < 0) missing.push(what(wanted.get(name)));
      else this.now[name] = found;
    };
    look(
      "tick",
      (text) => {
        const tick = text.trim() === "" ? NaN : Number(text) - first;
        return Number.isInteger(tick) && tick < run.count ? tick : -1;
      },
      (text) => `no tick ${text} (the page has ${first} to ${first + run.count - 1})`,
    );
    look(
      "agent",
      (id) => run.names.get(id) ?? -1,
      (id) => `no agent ${id}`,
    );
    look(
      "clause",
      (label) => clauses.slice(0, counted).findIndex((clause) => clause.label === label),
      (label) => `no clause ${label}`,
    );
    this.notify(missing.length ? `Not found: ${missing.join("; ")}.` : "");
  }

  writeAddress() {
    const wanted = new URLSearchParams({ tick: this.run.data.first + this.now.tick });
    if (this.now.agent >= 0) wanted.set("agent", this.run.data.agents[this.now.agent].id);
    if (this.now.clause >= 0) wanted.set("clause", this.runs[this.now.of].label(this.now.clause));
    if (this.now.clause >= 0 && this.now.of) wanted.set("run", "2");
    history.replaceState(null, "", `#${wanted}`);
    $("open").href = `${location.pathname}#${wanted}`;
  }

  refresh() {
    const { tick, playing, clause, of } = this.now;
    $("scrub").value = tick;
    $("tick").textContent = `tick ${this.run.data.first + tick}`;
    this.refreshControls();
    this.finder.fill(tick);
    this.chart.fillRows();
    const shown = `${clause} ${of}`;
    if (shown !== this.shownClause) {
      this.shownClause = shown;
      this.chart.draw();
    }
    for (const summary of this.summaries) summary.fillFilter();
    for (const panel of this.panels) panel.fill();
    this.draw();
    if (!playing) this.writeAddress();
  }

  /** Shows explanations that have arrived after the first frame. */
  loaded(before) {
    const { tick, agent } = this.now;
    if (agent < 0 || tick < Math.min(...before)) return;
    for (const panel of this.panels) panel.fill();
    this.draw();
  }
}

async function main() {
  requireBrowser();
  await pause();
  const parts = new Parts();
  let scenery, pair;
  const runs = [];
  await parts.each("scenery", (part) => {
    scenery = part;
  });
  const drawn = sceneryOf(scenery);
  await parts.each("pair", (part) => {
    pair = part;
  });
  await parts.each("run", (part) => runs.push(new RecordedRun(part)));
  const page = new Page(await drawn, runs, pair);
  await pause();
  performance.mark("first-frame");
  await parts.each("proofs", (part, number) => {
    const before = runs.map((run) => run.explained);
    runs[number].add(part);
    page.loaded(before);
  });
  $("loading").hidden = true;
  performance.mark("loaded");
}

main().catch(showFault);
