// The state of the page, and the controls that change it.

const SPEEDS = [1, 2, 5, 10, 20, 50];

class Page {
  /** Shows one run, or two runs with their differences. */
  constructor(scenery, runs, pair) {
    const [run] = runs;
    Object.assign(this, { scenery, runs, run });
    if (pair) for (const one of runs) one.count = pair.count;
    /** The state that determines the view, as positions or -1. `part` is the fraction of a tick that has passed; `of`
     *  is the run of the clause. */
    this.now = { tick: 0, agent: -1, clause: -1, of: 0, hover: -1, playing: false, speed: 5, follow: false, part: 0 };
    this.fitsMap = false;
    this.camera = new Camera(scenery.ground.map.rows, scenery.ground.map.cols);
    if (pair) {
      addSecondPane();
      document.documentElement.classList.add("pair");
      this.difference = new Differences(this, pair);
    }
    this.describe();
    this.summaries = runs.map((one, number) => new Summary(one, this, number));
    this.panels = runs.map((one, number) => new AgentPanel(one, this, number));
    this.maps = runs.map((one, number) => new CityMap(one, this, number));
    this.chart = new Chart(this);
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
    for (const speed of SPEEDS)
      $("speed").append(make("option", { value: speed, selected: speed === this.now.speed }, `${speed} /s`));
    const entry = (words, swatch) => $("legend").append(make("li", {}, swatch, words));
    for (const action of data.actions)
      entry(action, make("span", { class: "swatch", style: `background:${COLORS[action]}` }));
    if (this.runs.some((one) => one.data.driven)) entry("driven", make("span", { class: "swatch driven" }));
    if (difference) {
      entry("differs", make("span", { class: "swatch ring" }));
      entry("elsewhere", make("span", { class: "swatch ring dotted" }));
    }
    const embedded = new URLSearchParams(location.search).has("embed");
    document.documentElement.classList.toggle("embed", embedded);
    $("open").hidden = !embedded;
  }

  listen() {
    const press = (id, act) => $(id).addEventListener("click", act);
    press("play", () => this.play(!this.now.playing));
    press("first", () => this.choose({ tick: 0 }));
    press("back", () => this.step(-1));
    press("on", () => this.step(1));
    press("closer", () => this.maps[0].zoom(1.4));
    press("farther", () => this.maps[0].zoom(1 / 1.4));
    press("whole", () => this.turnFit());
    press("follow", () => this.choose({ follow: !this.now.follow }));
    press("help", () => $("keys").showModal());
    press("theme", () => this.turnTheme());
    press("copy", () => this.copyLink());
    press("next-difference", () => this.difference?.jump(1));
    for (const tab of document.querySelectorAll("#tabs button"))
      tab.addEventListener("click", () => this.showTab(tab.dataset.tab));
    $("scrub").addEventListener("input", () => this.choose({ tick: Number($("scrub").value) }));
    $("speed").addEventListener("change", () => {
      this.now.speed = Number($("speed").value);
    });
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => {
      this.readAddress();
      this.refresh();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolor());
    new ResizeObserver(() => this.resize()).observe($("stages"));
    this.showTab("why");
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open) return;
    const inField = ["SELECT", "INPUT"].includes(event.target.tagName);
    const onButton = ["BUTTON", "SUMMARY"].includes(event.target.tagName);
    const ten = event.shiftKey ? 10 : 1;
    const agents = this.run.agents;
    const speed = (by) => {
      const at = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.now.speed) + by));
      this.now.speed = SPEEDS[at];
      $("speed").value = SPEEDS[at];
    };
    const zoom = (by) => () => this.maps[0].zoom(by);
    const acts = {
      " ": onButton ? null : () => this.play(!this.now.playing),
      ArrowLeft: inField ? null : () => this.step(-ten),
      ArrowRight: inField ? null : () => this.step(ten),
      Home: () => this.choose({ tick: 0 }),
      End: () => this.choose({ tick: this.run.count - 1 }),
      "[": () => speed(-1),
      "]": () => speed(1),
      "+": zoom(1.4),
      "=": zoom(1.4),
      "-": zoom(1 / 1.4),
      0: () => this.turnFit(),
      f: () => this.choose({ follow: !this.now.follow }),
      n: () => this.choose({ agent: (this.now.agent + 1) % agents }),
      p: () => this.choose({ agent: (Math.max(this.now.agent, 0) + agents - 1) % agents }),
      d: this.difference ? () => this.difference.jump(event.shiftKey ? -1 : 1) : null,
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

  resize() {
    for (const map of this.maps) map.resize();
    if (this.camera.fits) this.fit(this.fitsMap);
    else this.draw();
  }

  /** Fits the region that agents visit, or the whole map. */
  fit(whole) {
    const {
      camera,
      maps: [{ canvas }],
    } = this;
    this.region ??= this.visited();
    this.fitsMap = whole;
    camera.frame(whole ? [0, 0, camera.rows, camera.cols] : this.region, canvas.width, canvas.height);
    this.setFollow(false);
    this.draw();
  }

  /** Fits the region that agents visit; if it fits already, the whole map, and so on in turn. */
  turnFit() {
    this.fit(this.camera.fits && !this.fitsMap);
  }

  /** Returns the rectangle that agents visit, with a margin. */
  visited() {
    const bounds = [Infinity, Infinity, -Infinity, -Infinity];
    for (const { cells } of this.runs) {
      for (let at = 0; at < cells.length; at += 2) {
        bounds[0] = Math.min(bounds[0], cells[at]);
        bounds[1] = Math.min(bounds[1], cells[at + 1]);
        bounds[2] = Math.max(bounds[2], cells[at]);
        bounds[3] = Math.max(bounds[3], cells[at + 1]);
      }
    }
    const [top, left, bottom, right] = bounds;
    const { rows, cols } = this.camera;
    return [Math.max(top - 8, 0), Math.max(left - 8, 0), Math.min(bottom + 9, rows), Math.min(right + 9, cols)];
  }

  draw() {
    const { now, camera, maps } = this;
    if (now.follow && now.agent >= 0) [camera.row, camera.col] = maps[0].place(now.agent);
    camera.clamp(maps[0].canvas.width, maps[0].canvas.height);
    for (const map of maps) map.draw();
    this.chart.drawCursor();
  }

  turnTheme() {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    this.recolor();
  }

  recolor() {
    this.chart.draw();
    this.draw();
  }

  /** Shows one of the sections that share a place on small screens, and beside two maps. */
  showTab(name) {
    document.querySelector("main").dataset.tab = name;
    for (const tab of document.querySelectorAll("#tabs button"))
      tab.setAttribute("aria-pressed", tab.dataset.tab === name);
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

  setFollow(on) {
    this.now.follow = on;
    $("follow").setAttribute("aria-pressed", on);
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

  /** Shows a notice above the page; an empty text hides it. */
  notify(text) {
    $("notice").hidden = !text;
    $("notice").textContent = text;
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
    const { tick, playing, follow, clause, of } = this.now;
    $("scrub").value = tick;
    $("tick").textContent = `tick ${this.run.data.first + tick}`;
    $("play").textContent = playing ? "❚❚" : "▶\uFE0E";
    $("play").setAttribute("aria-label", playing ? "pause" : "play");
    $("follow").setAttribute("aria-pressed", follow);
    $("follow").disabled = this.now.agent < 0;
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
  if (!("DecompressionStream" in window) || !CSS.supports("color", "light-dark(#000, #fff)")) {
    throw new Error("the browser is too old; it requires Chromium 123, Firefox 120, Safari 17.5 or later");
  }
  await pause();
  const parts = new Parts();
  let scenery, pair;
  const runs = [];
  await parts.each("scenery", (part) => {
    scenery = part;
  });
  const atlases = Promise.all(scenery.atlases.map((atlas) => Atlas.of(atlas)));
  await parts.each("pair", (part) => {
    pair = part;
  });
  await parts.each("run", (part) => runs.push(new Run(part)));
  const named = (await atlases).map(
    (atlas, at) => atlas && Object.assign(atlas, { name: ["car", "pedestrian", "building"][at] }),
  );
  const [cars, pedestrians, buildings] = named;
  const page = new Page(
    { ground: new Ground(scenery.map, buildings), icons: scenery.icons, cars, pedestrians },
    runs,
    pair,
  );
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

main().catch((error) => {
  $("loading").hidden = true;
  $("fault").hidden = false;
  $("fault").textContent = `Cannot show this page: ${error.message}`;
  throw error;
});
