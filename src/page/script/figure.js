// Figures of the map and the timeline, to save as SVG or PNG.

class Figure {
  constructor(page) {
    Object.assign(this, { page, now: page.now });
    for (const button of document.querySelectorAll("#formats button")) {
      button.addEventListener("click", async () => {
        const { figure, format } = button.dataset;
        $("formats").hidePopover();
        this.download(await (format === "svg" ? this.svg(figure) : this.png(figure)), `${this.name(figure)}.${format}`);
      });
    }
  }

  /** Returns the name of a file, such as `expert-tick-20-Car_1`. */
  name(figure) {
    const { data } = this.page.run;
    const agent = this.now.agent < 0 ? "" : `-${data.agents[this.now.agent].id}`;
    const words =
      figure === "map" ? `${data.config}-tick-${data.first + this.now.tick}${agent}` : `${data.config}-timeline`;
    return words.replace(/[^\w.-]+/g, "-");
  }

  download(blob, name) {
    const link = make("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    this.page.notify(`Saved ${name}.`);
  }

  /** Returns the figure as an SVG file. */
  svg(figure) {
    const { width, height } = this.size(figure);
    const paint = new SvgPaint(width, height);
    this.draw(paint, figure, width, height);
    return new Blob([paint.text()], { type: "image/svg+xml" });
  }

  /** Returns the figure as a PNG file, with two pixels per unit of its SVG. */
  png(figure) {
    const { width, height } = this.size(figure);
    const canvas = new OffscreenCanvas(2 * width, 2 * height);
    const paint = canvas.getContext("2d");
    paint.scale(2, 2);
    paint.imageSmoothingQuality = "high";
    this.draw(paint, figure, width, height);
    return canvas.convertToBlob({ type: "image/png" });
  }

  size(figure) {
    const { maps, chart } = this.page;
    if (figure === "map")
      return {
        width: (maps.length * maps[0].canvas.width) / pixelUnit() + 8 * (maps.length - 1),
        height: maps[0].canvas.height / pixelUnit() + 58,
      };
    return { width: 1100, height: ROW * chart.rows.length + 84 };
  }

  draw(paint, figure, width, height) {
    paint.fillStyle = isDark() ? "#16181c" : "#ffffff";
    paint.fillRect(0, 0, width, height);
    const {
      page,
      page: {
        run: { data },
      },
    } = this;
    const names = page.difference ? page.difference.names.join(" | ") : data.title;
    this.text(paint, figure === "map" ? `${names}, tick ${data.first + this.now.tick}` : names, 8, 15, 600);
    if (figure === "map") this.drawMaps(paint, height);
    else this.drawChart(paint, width, height);
    this.drawLegend(paint, figure, 8, height - 14);
  }

  drawMaps(paint, height) {
    const unit = pixelUnit();
    this.page.maps.forEach((map, number) => {
      const [width, high] = [map.canvas.width / unit, map.canvas.height / unit];
      this.part(paint, number * (width + 8), 30, width, Math.min(high, height - 58), unit, () => {
        map.scenery.ground.draw(paint, map.frame());
        map.drawAgents(paint);
      });
    });
  }

  drawChart(paint, width, height) {
    const { chart, run, difference } = this.page;
    const [left, top] = [110, difference ? 46 : 30];
    const [wide, high] = [width - left - 20, ROW * chart.rows.length];
    chart.rows.forEach(({ group, agent }, place) => {
      const y = top + (place + 0.5) * ROW;
      if (group) this.text(paint, `${group.name} (${this.page.roster.count(group)})`, 8, y, 600);
      else this.text(paint, run.data.agents[agent].id, left - 6, y, 400, "right");
    });
    if (difference) {
      this.text(paint, "differences", left - 6, top - 9, 400, "right");
      this.part(paint, left, top - 16, wide, 14, 1, () => difference.paint(paint, wide, 14));
    }
    this.part(paint, left, top, wide, high, 1, () => chart.paint(paint, wide, high));
    this.text(paint, "tick", left - 6, top + high + 12, 400, "right");
    for (const tick of chart.labels(wide))
      this.text(
        paint,
        String(run.data.first + tick),
        left + ((tick + 0.5) / run.count) * wide,
        top + high + 12,
        400,
        "center",
      );
  }

  drawLegend(paint, figure, x, y) {
    const { run, scenery } = this.page;
    const zones = figure === "map" ? scenery.ground.zones.filter(({ isShown }) => isShown) : [];
    const entries = run.data.actions.map((action) => [action, COLORS[action]]);
    for (const [name, color] of [...entries, ...zones.map(({ name, color }) => [name, color])]) {
      paint.fillStyle = color;
      paint.fillRect(x, y - 6, 12, 12);
      x += 18 + this.text(paint, name, x + 17, y) + 16;
    }
  }

  /** Writes a text and returns its width. */
  text(paint, words, x, y, weight = 400, align = "left") {
    Object.assign(paint, {
      font: `${weight} 12px system-ui, sans-serif`,
      textAlign: align,
      textBaseline: "middle",
      fillStyle: isDark() ? "#e8e6e1" : "#1d2026",
    });
    paint.fillText(words, x, y);
    return paint.measureText(words).width;
  }

  /** Draws a part with its own origin, in which a unit of the figure has `unit` pixels. */
  part(paint, x, y, width, height, unit, draw) {
    if (paint.pushPart) {
      paint.pushPart(x, y, width, height, unit);
      draw();
      paint.popPart();
      return;
    }
    paint.save();
    paint.beginPath();
    paint.rect(x, y, width, height);
    paint.clip();
    paint.translate(x, y);
    paint.scale(1 / unit, 1 / unit);
    draw();
    paint.restore();
  }
}
