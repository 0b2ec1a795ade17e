// The timeline: the action of every agent in every tick.

/** The height of a row, in page pixels. */
const ROW = 14;

class Chart {
  constructor(page) {
    Object.assign(this, { page, runs: page.runs, run: page.runs[0], now: page.now });
    this.nameRows();
    this.draw();
    this.listen();
  }

  nameRows() {
    this.names = this.run.data.agents.map(({ id, concepts }, agent) =>
      make(
        "button",
        {
          type: "button",
          tabindex: -1,
          title: [id, ...concepts].join(" "),
          style: `height:${ROW}px`,
          onclick: () => this.page.choose({ agent }),
        },
        id,
      ),
    );
    $("rows").append(...this.names);
  }

  listen() {
    new ResizeObserver(() => this.draw()).observe($("strip-box"));
    const strip = $("strip");
    const decision = (event) => {
      const box = strip.getBoundingClientRect();
      const within = (share, count) => Math.max(0, Math.min(count - 1, Math.floor(share * count)));
      const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
      return [within(x, this.run.count), within(y, this.run.agents)];
    };
    const seek = (event) => {
      const [tick, agent] = decision(event);
      this.page.choose({ tick, agent });
    };
    strip.addEventListener("pointerdown", (event) => {
      strip.setPointerCapture(event.pointerId);
      seek(event);
    });
    strip.addEventListener("pointermove", (event) => {
      if (event.buttons) return seek(event);
      const [tick, agent] = decision(event);
      const actions = this.runs.map((run) => run.action(tick, agent));
      const { agents, first } = this.run.data;
      strip.title = `${agents[agent].id}, tick ${first + tick}: ${[...new Set(actions)].join(" and ")}`;
    });
  }

  /** Draws the chart and its axis. */
  draw() {
    const strip = $("strip");
    const unit = pixelUnit();
    strip.style.height = `${ROW * this.run.agents}px`;
    strip.width = Math.max(1, Math.round($("plot").clientWidth * unit));
    strip.height = Math.max(1, Math.round(ROW * this.run.agents * unit));
    this.paint(strip.getContext("2d"), strip.width, strip.height);
    this.page.difference?.drawMarks($("plot").clientWidth);
    this.drawAxis();
    this.drawCursor();
  }

  /** Draws the rows of all agents. With two runs, a row has a lane for each. */
  paint(paint, width, height) {
    const row = height / this.run.agents;
    const { clause, of } = this.now;
    const lanes = this.runs.length;
    paint.fillStyle = isDark() ? "#1f2228" : "#ffffff";
    paint.fillRect(0, 0, width, height);
    this.runs.forEach((run, lane) => {
      const fired = clause >= 0 && of === lane ? run.data.fired_sets.map((set) => set.includes(clause)) : null;
      for (let agent = 0; agent < run.agents; agent += 1) {
        const [top, bottom] = [
          agent * row + (lane * (row - 1)) / lanes,
          agent * row + ((lane + 1) * (row - 1)) / lanes,
        ];
        this.paintLane(paint, run, agent, fired, width, top, bottom);
      }
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

  /** Frames deadlocks, and marks the ticks in which a driven agent violated a clause. */
  paintMarks(paint, width, row) {
    const lanes = this.runs.length;
    this.runs.forEach(({ data }, lane) => {
      const unit = row / ROW;
      const [offset, high] = [(lane * (row - 1)) / lanes, (row - 1) / lanes];
      paint.strokeStyle = isDark() ? "#ffffff" : "#000000";
      paint.lineWidth = 1.5 * unit;
      for (const { agents, since, until } of data.deadlocks) {
        const x = ((since - data.first) / this.run.count) * width;
        const end = Math.min(((until + 1 - data.first) / this.run.count) * width, width);
        if (x >= width) continue;
        for (const agent of agents)
          paint.strokeRect(
            x + unit,
            agent * row + offset + 0.75 * unit,
            Math.max(end - x - 1.5 * unit, 2 * unit),
            high - 1.5 * unit,
          );
      }
      paint.fillStyle = paint.strokeStyle;
      for (const { tick, agent, broken } of data.driven ?? []) {
        if (!broken.length || tick >= this.run.count) continue;
        const [left, right] = [tick, tick + 1].map((at) => (at / this.run.count) * width);
        paint.fillRect(left, agent * row + offset, Math.max(right - left, 3 * unit), high);
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
    $("row-cursor").hidden = agent < 0;
    if (agent >= 0) Object.assign($("row-cursor").style, { top: `${agent * ROW}px`, height: `${ROW}px` });
    if (agent === this.markedRow) return;
    this.names[this.markedRow]?.removeAttribute("aria-current");
    this.names[agent]?.setAttribute("aria-current", "true");
    this.markedRow = agent;
    const box = $("strip-box");
    const top = agent * ROW;
    if (agent >= 0 && (top < box.scrollTop || top + ROW > box.scrollTop + box.clientHeight))
      box.scrollTop = top - ROW * Math.floor(box.clientHeight / ROW / 2);
  }
}
