// The timeline: the action of every agent in every tick.

/** The height of a row, in page pixels, and on a screen for fingers. */
const ROW = 14;
const TOUCH_ROW = 24;
const TOUCH = matchMedia("(max-width: 820px), (pointer: coarse)");

class Chart {
  constructor(page) {
    Object.assign(this, { page, runs: page.runs, run: page.runs[0], now: page.now });
    this.fillRows();
    this.listen();
  }

  /** The height of a row, in page pixels. */
  get row() {
    return TOUCH.matches ? TOUCH_ROW : ROW;
  }

  /** Lists the agents that match the filter in the present tick, below the name of their kind. A row is an agent or a
   *  group. */
  fillRows() {
    const { roster } = this.page;
    const groups = roster.groups(this.now.tick);
    const rows = groups.flatMap((group) => [
      { group },
      ...(roster.closed.has(group.name) ? [] : group.agents.map((agent) => ({ agent }))),
    ]);
    const key = JSON.stringify([groups, [...roster.closed], this.row]);
    if (key === this.rowsKey) return;
    Object.assign(this, { rowsKey: key, rows, places: new Map(rows.map(({ agent }, place) => [agent, place])) });
    this.names = new Map();
    $("rows").replaceChildren(...rows.map(({ group, agent }) => (group ? this.nameGroup(group) : this.nameAgent(agent))));
    this.markedRow = undefined;
    this.draw();
  }

  nameGroup(group) {
    const { roster } = this.page;
    const isOpen = !roster.closed.has(group.name);
    const turn = () => {
      if (isOpen) roster.closed.add(group.name);
      else roster.closed.delete(group.name);
      this.fillRows();
    };
    const words = `${group.name} (${roster.count(group)})`;
    const short = `${group.name} (${roster.count(group).replace(" of ", "/")})`;
    const attributes = {
      type: "button",
      class: "group",
      title: `${words}: ${isOpen ? "hide" : "show"} these agents`,
      "aria-expanded": String(isOpen),
      style: `height:${this.row}px`,
      onclick: turn,
    };
    return make("button", attributes, `${isOpen ? "▾" : "▸"} ${short}`);
  }

  nameAgent(agent) {
    const { id, concepts } = this.run.data.agents[agent];
    const attributes = {
      type: "button",
      tabindex: -1,
      title: [id, ...concepts].join(" "),
      style: `height:${this.row}px`,
      onclick: () => this.page.choose({ agent }),
    };
    const name = make("button", attributes, id);
    this.names.set(agent, name);
    return name;
  }

  listen() {
    TOUCH.addEventListener("change", () => this.fillRows());
    new ResizeObserver(() => this.draw()).observe($("strip-box"));
    const strip = $("strip");
    const decision = (event) => {
      const box = strip.getBoundingClientRect();
      const within = (share, count) => Math.max(0, Math.min(count - 1, Math.floor(share * count)));
      const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
      return [within(x, this.run.count), this.rows[within(y, this.rows.length)]?.agent];
    };
    const seek = (event) => {
      const [tick, agent] = decision(event);
      this.page.choose(agent === undefined ? { tick } : { tick, agent });
    };
    strip.addEventListener("pointerdown", (event) => {
      strip.setPointerCapture(event.pointerId);
      seek(event);
    });
    strip.addEventListener("pointermove", (event) => {
      if (event.buttons) return seek(event);
      const [tick, agent] = decision(event);
      const { agents, first } = this.run.data;
      if (agent === undefined) {
        strip.title = `tick ${first + tick}`;
        return;
      }
      const actions = this.runs.map((run) => run.action(tick, agent));
      strip.title = `${agents[agent].id}, tick ${first + tick}: ${[...new Set(actions)].join(" and ")}`;
    });
  }

  /** Draws the chart and its axis. */
  draw() {
    const strip = $("strip");
    const unit = pixelUnit();
    const high = this.row * this.rows.length;
    strip.style.height = `${high}px`;
    strip.width = Math.max(1, Math.round($("plot").clientWidth * unit));
    strip.height = Math.max(1, Math.round(high * unit));
    this.paint(strip.getContext("2d"), strip.width, strip.height);
    this.page.difference?.drawMarks($("plot").clientWidth);
    this.drawAxis();
    this.drawCursor();
  }

  /** Draws the rows. With two runs, a row has a lane for each. */
  paint(paint, width, height) {
    const row = height / Math.max(1, this.rows.length);
    const { clause, of } = this.now;
    const lanes = this.runs.length;
    paint.fillStyle = isDark() ? "#1f2228" : "#ffffff";
    paint.fillRect(0, 0, width, height);
    this.runs.forEach((run, lane) => {
      const fired = clause >= 0 && of === lane ? run.data.fired_sets.map((set) => set.includes(clause)) : null;
      this.rows.forEach(({ group, agent }, place) => {
        const [top, bottom] = [lane, lane + 1].map((at) => place * row + (at * (row - 1)) / lanes);
        if (!group) this.paintLane(paint, run, agent, fired, width, top, bottom);
        else if (this.page.roster.closed.has(group.name)) this.paintShares(paint, run, group, width, top, bottom);
      });
    });
    this.paintMarks(paint, width, row);
  }

  /** Draws the actions of an agent: a rectangle for each number of equal ticks. Firings of a chosen clause are bright
   *  and at least a pixel wide. */
  paintLane(paint, run, agent, fired, width, top, bottom) {
    const scale = width / this.run.count;
    const kind = (tick) => 2 * run.act(tick, agent) + (fired && fired[run.data.fired[agent][tick]] ? 1 : 0);
    const bars = [];
    for (let tick = 0, since = 0; tick < this.run.count; tick += 1) {
      if (tick + 1 < this.run.count && kind(tick + 1) === kind(since)) continue;
      bars.push([since, tick + 1, kind(since)]);
      since = tick + 1;
    }
    for (const bright of [0, 1]) {
      for (const [from, to, what] of bars) {
        if (what % 2 !== bright) continue;
        const [left, right] = [Math.round(from * scale), Math.round(to * scale)];
        if (left === right && !bright) continue;
        paint.fillStyle = COLORS[run.data.actions[what >> 1]];
        paint.globalAlpha = fired && !bright ? 0.18 : 1;
        paint.fillRect(left, top, Math.max(right - left, bright), bottom - top);
      }
    }
    paint.globalAlpha = 1;
  }

  /** Draws the shares of the actions of a group in each tick, one above the other. */
  paintShares(paint, run, { agents }, width, top, bottom) {
    const scale = width / this.run.count;
    for (let tick = 0; tick < this.run.count; tick += 1) {
      const [left, right] = [Math.round(tick * scale), Math.round((tick + 1) * scale)];
      if (left === right) continue;
      const counts = new Array(run.data.actions.length).fill(0);
      for (const agent of agents) counts[run.act(tick, agent)] += 1;
      let before = 0;
      const edge = (sum) => Math.round(top + ((bottom - top) * sum) / agents.length);
      counts.forEach((count, action) => {
        paint.fillStyle = COLORS[run.data.actions[action]];
        paint.fillRect(left, edge(before), right - left, edge(before + count) - edge(before));
        before += count;
      });
    }
  }

  /** Frames deadlocks, and marks the ticks in which a driven agent violated a clause. */
  paintMarks(paint, width, row) {
    const lanes = this.runs.length;
    this.runs.forEach(({ data }, lane) => {
      const unit = row / this.row;
      const [offset, high] = [(lane * (row - 1)) / lanes, (row - 1) / lanes];
      paint.strokeStyle = isDark() ? "#ffffff" : "#000000";
      paint.lineWidth = 1.5 * unit;
      for (const { agents, since, until } of data.deadlocks) {
        const x = ((since - data.first) / this.run.count) * width;
        const end = Math.min(((until + 1 - data.first) / this.run.count) * width, width);
        if (x >= width) continue;
        for (const place of agents.map((agent) => this.places.get(agent)).filter((place) => place !== undefined))
          paint.strokeRect(
            x + unit,
            place * row + offset + 0.75 * unit,
            Math.max(end - x - 1.5 * unit, 2 * unit),
            high - 1.5 * unit,
          );
      }
      paint.fillStyle = paint.strokeStyle;
      for (const { tick, agent, broken } of data.driven ?? []) {
        const place = this.places.get(agent);
        if (!broken.length || tick >= this.run.count || place === undefined) continue;
        const [left, right] = [tick, tick + 1].map((at) => (at / this.run.count) * width);
        paint.fillRect(left, place * row + offset, Math.max(right - left, 3 * unit), high);
      }
    });
  }

  /** Returns the ticks with a label, as positions. */
  labels(width) {
    const { first } = this.run.data;
    const most = Math.max(2, Math.floor(width / 70));
    const step =
      [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((size) => this.run.count / size <= most) ??
      10 ** Math.ceil(Math.log10(this.run.count / most));
    const from = Math.ceil(first / step) * step;
    return Array.from(
      { length: Math.max(0, Math.ceil((first + this.run.count - from) / step)) },
      (_, at) => from + at * step - first,
    );
  }

  drawAxis() {
    const width = $("plot").clientWidth;
    $("axis").style.width = `${width}px`;
    const label = (tick) => {
      const x = ((tick + 0.5) / this.run.count) * width;
      return make(
        "span",
        { style: `left:${x}px`, class: x < 12 ? "start" : x > width - 16 ? "end" : null },
        String(this.run.data.first + tick),
      );
    };
    $("axis").replaceChildren(...this.labels(width).map(label));
  }

  drawCursor() {
    const { tick, part, agent } = this.now;
    const width = $("plot").clientWidth;
    $("cursor").style.left = `${((tick + part + 0.5) / this.run.count) * width}px`;
    const place = this.places.get(agent);
    const { row } = this;
    $("row-cursor").hidden = place === undefined;
    if (place !== undefined) Object.assign($("row-cursor").style, { top: `${place * row}px`, height: `${row}px` });
    if (agent === this.markedRow) return;
    this.names.get(this.markedRow)?.removeAttribute("aria-current");
    this.names.get(agent)?.setAttribute("aria-current", "true");
    this.markedRow = agent;
    const box = $("strip-box");
    const top = place * row;
    if (place !== undefined && (top < box.scrollTop || top + row > box.scrollTop + box.clientHeight))
      box.scrollTop = top - row * Math.floor(box.clientHeight / row / 2);
  }
}
