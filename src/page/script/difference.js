// Where two runs differ.

class Differences {
  constructor(page, { names, differences }) {
    Object.assign(this, { page, names, runs: page.runs, list: differences, now: page.now });
    this.byTick = new Map(differences.map((difference) => [difference.tick, difference]));
    $("differing").hidden = false;
    for (const element of [$("marks"), $("marks-name")]) element.hidden = !differences.length;
    this.fill();
    this.listen();
  }

  /** Returns the agents that act differently in a tick and those in different cells; `undefined` if there are none. */
  at(tick) {
    return this.byTick.get(tick);
  }

  fill() {
    const {
      list,
      runs: [left],
    } = this;
    const decisions = list.reduce((sum, { acts }) => sum + acts.length, 0);
    const total = left.count * left.agents;
    const press = (id, by, words) => make("button", { type: "button", id, onclick: () => this.jump(by) }, words);
    const text = list.length
      ? [
          make("strong", {}, `${decisions} of ${total} decisions differ`),
          make(
            "button",
            { type: "button", id: "diverge", class: "primary", onclick: () => this.go(list[0]) },
            `first difference: tick ${left.data.first + list[0].tick}`,
          ),
          press("difference-back", -1, "◀ previous"),
          press("difference-on", 1, "next ▶"),
        ]
      : [make("strong", {}, `The runs agree in all ${total} decisions.`)];
    const ends = this.runs.map(({ data }) => data.count).filter((count) => count > left.count).length
      ? ` Later ticks of the longer run are not shown.`
      : null;
    $("differing").replaceChildren(...text, ...(ends ? [make("span", { class: "clause" }, ends)] : []));
  }

  listen() {
    const marks = $("marks");
    marks.addEventListener("pointerdown", (event) => {
      const box = marks.getBoundingClientRect();
      const tick = ((event.clientX - box.left) / box.width) * this.runs[0].count - 0.5;
      const near = this.list.reduce((a, b) => (Math.abs(b.tick - tick) < Math.abs(a.tick - tick) ? b : a));
      this.go(near);
    });
  }

  /** Goes to a difference: its tick, and an agent that acts differently or is elsewhere. */
  go({ tick, acts, apart }) {
    const { agent } = this.now;
    this.page.choose({ tick, agent: acts.includes(agent) ? agent : (acts[0] ?? apart[0]) });
  }

  /** Goes to the next or previous tick in which an agent acts differently; after the last one to the first. */
  jump(by) {
    const acting = this.list.filter(({ acts }) => acts.length);
    const found =
      by > 0 ? acting.find(({ tick }) => tick > this.now.tick) : acting.findLast(({ tick }) => tick < this.now.tick);
    const next = found ?? (by > 0 ? acting[0] : acting.at(-1));
    if (next) this.go(next);
  }

  drawMarks(width) {
    const marks = $("marks");
    const unit = pixelUnit();
    marks.style.width = `${width}px`;
    [marks.width, marks.height] = [Math.max(1, Math.round(width * unit)), 14 * unit];
    const paint = marks.getContext("2d");
    this.paint(paint, marks.width, marks.height);
  }

  /** Draws the ticks that differ: filled where agents act differently, pale where they are only in different cells. */
  paint(paint, width, height) {
    const { count, agents } = this.runs[0];
    paint.fillStyle = isDark() ? "#2a2e36" : "#eeece6";
    paint.fillRect(0, 0, width, height);
    const scale = width / count;
    for (const strong of [false, true]) {
      for (const { tick, acts } of this.list) {
        if (Boolean(acts.length) !== strong) continue;
        const left = Math.floor(tick * scale);
        const high = strong ? Math.max(0.5, Math.sqrt(acts.length / agents)) * height : 0.25 * height;
        paint.fillStyle = strong ? DIFFERENT : `${DIFFERENT}66`;
        paint.fillRect(left, height - high, Math.max(Math.ceil((tick + 1) * scale) - left, (2 * height) / 14), high);
      }
    }
  }
}
