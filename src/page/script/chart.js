// The chart of every agent's actions over time.

/** Browsers reject canvases that are much wider. */
const STRIP_COLUMNS = 8192;

class Chart {
  constructor(run, page) {
    Object.assign(this, { run, page, data: run.data, now: page.now });
    this.draw();
    this.listen();
  }

  listen() {
    new ResizeObserver(() => this.draw()).observe($("strip-box"));
    const strip = $("strip");
    const decision = (event) => {
      const box = strip.getBoundingClientRect();
      const within = (share, count) => Math.max(0, Math.min(count - 1, Math.floor(share * count)));
      const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
      return [within(x, this.run.count), within(y, this.data.agents.length)];
    };
    const seek = (event) => {
      const [tick, agent] = decision(event);
      this.page.choose({ tick, agent });
    };
    strip.addEventListener("pointerdown", (event) => { strip.setPointerCapture(event.pointerId); seek(event); });
    strip.addEventListener("pointermove", (event) => {
      if (event.buttons) return seek(event);
      const [tick, agent] = decision(event);
      strip.title = `${this.data.agents[agent].id}, tick ${this.data.first + tick}: ${this.run.action(tick, agent)}`;
    });
  }

  /** Draws one pixel per decision, scaled; in long runs several ticks share a pixel. */
  draw() {
    const { ticks, agents, actions } = this.data;
    const columns = Math.min(this.run.count, STRIP_COLUMNS);
    const small = new OffscreenCanvas(columns, agents.length);
    const paint = small.getContext("2d");
    const image = paint.createImageData(columns, agents.length);
    const colours = actions.map((action) => [1, 3, 5].map((at) => parseInt(COLORS[action].slice(at, at + 2), 16)));
    const { clause } = this.now;
    ticks.forEach(({ action, fired }, tick) => {
      // Multiplies first: integers stay exact, and no column is skipped.
      const column = Math.floor(tick * columns / this.run.count);
      for (let agent = 0; agent < agents.length; agent += 1) {
        const at = 4 * (agent * columns + column);
        const bright = clause < 0 || fired[agent].includes(clause);
        // A firing takes precedence over other ticks in the same pixel.
        if (image.data[at + 3] === 255 || (image.data[at + 3] > 0 && !bright)) continue;
        image.data.set(colours[action[agent]], at);
        image.data[at + 3] = bright ? 255 : 40;
      }
    });
    paint.putImageData(image, 0, 0);
    const strip = $("strip");
    const unit = pixelUnit();
    const row = Math.max(3, Math.min(12, Math.floor(170 / agents.length)));
    strip.style.height = `${row * agents.length}px`;
    strip.width = Math.max(1, Math.round($("strip-box").clientWidth * unit));
    strip.height = Math.max(1, row * agents.length * unit);
    const whole = new OffscreenCanvas(strip.width, strip.height);
    const large = whole.getContext("2d");
    large.imageSmoothingEnabled = false;
    large.drawImage(small, 0, 0, strip.width, strip.height);
    large.fillStyle = isDark() ? "#16181c" : "#f6f5f1";
    for (let agent = 1; agent < agents.length; agent += 1) large.fillRect(0, agent * row * unit, strip.width, unit);
    large.strokeStyle = isDark() ? "#ffffff" : "#000000";
    large.lineWidth = 2 * unit;
    for (const { agents: held, since, until } of this.data.deadlocks) {
      for (const agent of held) {
        const x = (since - this.data.first) / this.run.count * strip.width;
        const width = Math.max((until + 1 - since) / this.run.count * strip.width, 2 * unit);
        large.strokeRect(x, agent * row * unit + unit, width - unit, row * unit - unit);
      }
    }
    // Marks the ticks in which a driven agent violated a clause.
    large.fillStyle = isDark() ? "#ffffff" : "#000000";
    for (const { tick, agent, broken } of this.data.driven ?? []) {
      if (!broken.length) continue;
      const [left, right] = [tick, tick + 1].map((at) => at / this.run.count * strip.width);
      large.fillRect(left, agent * row * unit, Math.max(right - left, 3 * unit), row * unit);
    }
    this.strip = whole;
    this.drawCursor();
  }

  drawCursor() {
    const strip = $("strip");
    if (!this.strip) return;
    const paint = strip.getContext("2d");
    const unit = pixelUnit();
    paint.clearRect(0, 0, strip.width, strip.height);
    paint.drawImage(this.strip, 0, 0);
    const width = strip.width / this.run.count;
    const x = (this.now.tick + this.now.part) * width;
    paint.fillStyle = isDark() ? "#ffffff" : "#000000";
    paint.fillRect(x + (width - 2 * unit) / 2, 0, 2 * unit, strip.height);
    if (this.now.agent >= 0) {
      const row = strip.height / this.data.agents.length;
      paint.strokeStyle = paint.fillStyle;
      paint.lineWidth = 1.5 * unit;
      paint.strokeRect(0, this.now.agent * row, strip.width, row);
    }
  }
}
