// The state of the page, and the controls that change it.

const SPEEDS = [1, 2, 5, 10, 20, 50];

class Page {
  constructor(data, icons) {
    const run = new Run(data);
    Object.assign(this, { run, data });
    /** The state that determines the view, as positions or -1. `part` is the fraction of a tick that has passed. */
    this.now = { tick: 0, agent: -1, clause: -1, hover: -1, playing: false, speed: 5, follow: false, part: 0 };
    this.summary = new Summary(run, this);
    this.agent = new AgentPanel(run, this);
    this.chart = new Chart(run, this);
    this.map = new CityMap(run, this, icons);
    this.listen();
    this.readAddress();
    this.map.resize();
    this.refresh();
  }

  listen() {
    const press = (id, act) => $(id).addEventListener("click", act);
    press("play", () => this.play(!this.now.playing));
    press("first", () => this.choose({ tick: 0 }));
    press("back", () => this.step(-1));
    press("on", () => this.step(1));
    press("closer", () => this.map.zoom(1.4));
    press("farther", () => this.map.zoom(1 / 1.4));
    press("whole", () => this.map.showWhole());
    press("follow", () => this.choose({ follow: !this.now.follow }));
    press("help", () => $("keys").showModal());
    press("theme", () => this.turnTheme());
    $("scrub").addEventListener("input", () => this.choose({ tick: Number($("scrub").value) }));
    $("speed").addEventListener("change", () => { this.now.speed = Number($("speed").value); });
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => { this.readAddress(); this.refresh(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolor());
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
      End: () => this.choose({ tick: this.run.count - 1 }),
      "[": () => speed(-1),
      "]": () => speed(1),
      "+": () => this.map.zoom(1.4),
      "=": () => this.map.zoom(1.4),
      "-": () => this.map.zoom(1 / 1.4),
      0: () => this.map.showWhole(),
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

  draw() {
    this.map.draw();
    this.chart.drawCursor();
  }

  turnTheme() {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    this.recolor();
  }

  recolor() {
    this.map.drawGround();
    this.chart.draw();
    this.draw();
  }

  choose(changes) {
    this.notify("");
    Object.assign(this.now, { part: 0 }, changes);
    if (this.now.agent < 0) this.now.follow = false;
    if ("tick" in changes && !changes.keep) this.stop();
    this.refresh();
  }

  step(by) {
    this.choose({ tick: Math.max(0, Math.min(this.run.count - 1, this.now.tick + by)) });
  }

  /** Goes to the next or previous firing of the chosen clause, or change of the chosen agent's action. */
  jump(by) {
    const { tick, agent, clause } = this.now;
    if (clause >= 0) {
      const all = this.run.firings[clause];
      const key = ([t, a]) => t * this.data.agents.length + a;
      const here = key([tick, Math.max(agent, 0)]) + (agent < 0 && by > 0 ? -0.5 : 0);
      const found = by > 0 ? all.find((one) => key(one) > here) : all.findLast((one) => key(one) < here);
      if (found) this.choose({ tick: found[0], agent: found[1] });
      return;
    }
    if (agent < 0) return;
    for (let at = tick + by; at >= 0 && at < this.run.count; at += by) {
      if (this.run.action(at, agent) !== this.run.action(tick, agent)) return this.choose({ tick: at });
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
    const passed = this.clock === undefined ? 0 : (time - this.clock) / 1000 * this.now.speed;
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

  /** Reads an address such as `#tick=20&agent=Car_1&clause=S4`, and reports values that do not exist. */
  readAddress() {
    const { data: { first, clauses, counted }, run } = this;
    const wanted = new URLSearchParams(location.hash.slice(1));
    const missing = [];
    const look = (name, position, what) => {
      if (!wanted.has(name)) return;
      const found = position(wanted.get(name));
      if (found < 0) missing.push(what(wanted.get(name)));
      else this.now[name] = found;
    };
    look("tick", (text) => {
      const tick = text.trim() === "" ? NaN : Number(text) - first;
      return Number.isInteger(tick) && tick < run.count ? tick : -1;
    }, (text) => `no tick ${text} (the page has ${first} to ${first + run.count - 1})`);
    look("agent", (id) => run.names.get(id) ?? -1, (id) => `no agent ${id}`);
    look("clause", (label) => clauses.slice(0, counted).findIndex((clause) => clause.label === label), (label) => `no clause ${label}`);
    this.notify(missing.length ? `Not found: ${missing.join("; ")}.` : "");
  }

  /** Shows a notice above the page; an empty text hides it. */
  notify(text) {
    $("notice").hidden = !text;
    $("notice").textContent = text;
  }

  writeAddress() {
    const wanted = new URLSearchParams({ tick: this.data.first + this.now.tick });
    if (this.now.agent >= 0) wanted.set("agent", this.data.agents[this.now.agent].id);
    if (this.now.clause >= 0) wanted.set("clause", this.run.label(this.now.clause));
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
      this.chart.draw();
    }
    this.summary.fillFilter();
    this.agent.fill();
    this.draw();
    if (!playing) this.writeAddress();
  }
}

async function main() {
  if (!("DecompressionStream" in window) || !CSS.supports("color", "light-dark(#000, #fff)")) {
    throw new Error("the browser is too old; it requires Chromium 123, Firefox 120, Safari 17.5 or later");
  }
  const data = await unpack($("data").textContent);
  $("data").remove();
  const bitmaps = data.icons.map(async (icon) => createImageBitmap(new Blob([bytesOf(icon)], { type: "image/png" })));
  new Page(data, await Promise.all(bitmaps));
}

main().catch((error) => {
  $("fault").hidden = false;
  $("fault").textContent = `Cannot show this page: ${error.message}`;
  throw error;
});
