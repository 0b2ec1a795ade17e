// The parts of a page that show a city: maps, legend, tools and panels. A subclass decides what the runs are.

class Viewer {
  constructor(scenery, runs) {
    const [run] = runs;
    Object.assign(this, { scenery, runs, run });
    /** The state that determines the view, as positions or -1. `part` is the fraction of a tick that has passed; `of`
     *  is the run of the clause. */
    this.now = { tick: 0, agent: -1, clause: -1, of: 0, hover: -1, playing: false, speed: 5, follow: false, part: 0 };
    this.fitsMap = false;
    this.roster = new Roster(this);
    this.camera = new Camera(scenery.ground.map.rows, scenery.ground.map.cols);
  }

  /** Creates the panels and the maps of the runs. */
  addPanes() {
    this.panels = this.runs.map((one, number) => new AgentPanel(one, this, number));
    this.maps = this.runs.map((one, number) => new CityMap(one, this, number));
  }

  press(id, act) {
    $(id).addEventListener("click", act);
  }

  /** Adds an entry to the legend. */
  explainColor(words, swatch) {
    $("legend").append(make("li", {}, swatch, words));
  }

  /** Adds the zones of the map to the legend; a click on a zone hides or shows it. */
  explainZones() {
    for (const old of document.querySelectorAll("#legend .zone")) old.parentElement.remove();
    for (const zone of this.scenery.ground.zones) {
      const swatch = make("span", { class: "swatch", style: `background:${zone.color}` });
      const button = make("button", { type: "button", class: "zone", title: "hide or show this zone" }, swatch, zone.name);
      const show = (isShown) => {
        zone.isShown = isShown;
        button.setAttribute("aria-pressed", isShown);
      };
      show(zone.isShown);
      button.addEventListener("click", () => {
        show(!zone.isShown);
        for (const map of this.maps) map.forgetGround();
        this.draw();
      });
      $("legend").append(make("li", {}, button));
    }
  }

  /** Fills in the colors of the actions and of the zones, and the speeds. */
  describeControls(speeds) {
    for (const action of this.run.data.actions)
      this.explainColor(action, make("span", { class: "swatch", style: `background:${COLORS[action]}` }));
    this.explainZones();
    for (const speed of speeds)
      $("speed").append(make("option", { value: speed, selected: speed === this.now.speed }, `${speed} /s`));
  }

  /** Listens to the tools of the map, the theme, the tabs and the size. */
  listenToTools() {
    this.press("closer", () => this.maps[0].zoom(1.4));
    this.press("farther", () => this.maps[0].zoom(1 / 1.4));
    this.press("whole", () => this.turnFit());
    this.press("follow", () => this.choose({ follow: !this.now.follow }));
    this.press("theme", () => this.turnTheme());
    for (const tab of document.querySelectorAll("#tabs button"))
      tab.addEventListener("click", () => this.showTab(tab.dataset.tab));
    $("speed").addEventListener("change", () => {
      this.now.speed = Number($("speed").value);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolor());
    new ResizeObserver(() => this.resize()).observe($("stages"));
  }

  /** Returns the actions of keys that every page has. */
  keys() {
    const zoom = (by) => () => this.maps[0].zoom(by);
    return {
      "+": zoom(1.4),
      "=": zoom(1.4),
      "-": zoom(1 / 1.4),
      0: () => this.turnFit(),
      f: () => this.choose({ follow: !this.now.follow }),
      n: () => this.chooseNext(1),
      p: () => this.chooseNext(-1),
      Escape: () => this.choose({ agent: -1, clause: -1 }),
    };
  }

  /** Chooses the next or the previous one of the agents that match the filter. */
  chooseNext(by) {
    const agents = this.roster.agents(this.now.tick);
    if (!agents.length) return;
    const at = agents.indexOf(this.now.agent);
    const from = at < 0 && by < 0 ? 0 : at;
    this.choose({ agent: agents[(from + by + agents.length) % agents.length] });
  }

  /** Performs the action of a key, if it has one. */
  useKey(event, acts) {
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
    this.nameFit();
    this.draw();
  }

  /** Names what a click on the button for the fit shows. */
  nameFit() {
    const words = this.camera.fits && !this.fitsMap ? "show the whole map" : "show all agents";
    Object.assign($("whole"), { title: `${words} (0)` });
    $("whole").setAttribute("aria-label", words);
  }

  /** Fits the region that agents visit; if it fits already, the whole map, and so on in turn. */
  turnFit() {
    this.fit(this.camera.fits && !this.fitsMap);
  }

  /** Returns the rectangle that agents visit, with a margin. */
  visited() {
    const bounds = [Infinity, Infinity, -Infinity, -Infinity];
    for (const run of this.runs) {
      const [top, left, bottom, right] = run.bounds();
      extend(bounds, [top, left]);
      extend(bounds, [bottom, right]);
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
  }

  turnTheme() {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    this.recolor();
  }

  recolor() {
    this.draw();
  }

  /** Shows one of the sections that share a place on small screens, and beside two maps. */
  showTab(name) {
    document.querySelector("main").dataset.tab = name;
    for (const tab of document.querySelectorAll("#tabs button"))
      tab.setAttribute("aria-pressed", tab.dataset.tab === name);
  }

  setFollow(on) {
    this.now.follow = on;
    $("follow").setAttribute("aria-pressed", on);
  }

  /** Shows a notice above the page; an empty text hides it. */
  notify(text) {
    $("notice").hidden = !text;
    $("notice").textContent = text;
  }

  /** Shows whether the city moves and whether the map follows the chosen agent. */
  refreshControls() {
    const { playing, follow, agent } = this.now;
    $("play").textContent = playing ? "❚❚" : "▶\uFE0E";
    $("play").setAttribute("aria-label", playing ? "pause" : "play");
    $("follow").setAttribute("aria-pressed", follow);
    $("follow").disabled = agent < 0;
  }
}
