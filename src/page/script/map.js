// The map of a run: the city from above.

/** The clockwise rotation of an icon that faces up, in radians. */
const TURNS = { Up: 0, Right: Math.PI / 2, Down: Math.PI, Left: -Math.PI / 2 };

/** The side of an agent, in cells, and its least side, in page pixels. */
const SIDES = { Car: [4, 9], Pedestrian: [4, 13] };

/** The part of the city that all maps of the page show. */
class Camera {
  constructor(rows, cols) {
    Object.assign(this, { rows, cols, row: rows / 2, col: cols / 2, scale: 1, fits: true });
  }

  /** Shows a rectangle of cells as large as it fits. */
  frame([top, left, bottom, right], width, height) {
    this.row = (top + bottom) / 2;
    this.col = (left + right) / 2;
    this.scale = Math.min(width / (right - left), height / (bottom - top));
    this.fits = true;
    this.clamp(width, height);
  }

  /** Keeps the map in view. */
  clamp(width, height) {
    const keep = (at, pixels, cells) => {
      const half = pixels / this.scale / 2;
      return 2 * half >= cells ? cells / 2 : Math.max(half, Math.min(cells - half, at));
    };
    this.row = keep(this.row, height, this.rows);
    this.col = keep(this.col, width, this.cols);
  }
}

class CityMap {
  constructor(run, page, number) {
    Object.assign(this, { run, page, number, now: page.now, camera: page.camera, scenery: page.scenery });
    this.stage = $(paneId("stage", number));
    this.canvas = $(paneId("map", number));
    this.stillMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.below = new OffscreenCanvas(1, 1);
    this.listen();
  }

  resize() {
    const scale = pixelUnit();
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    this.forgetGround();
  }

  /** Makes the next frame draw the ground again. */
  forgetGround() {
    this.groundKey = "";
  }

  /** Zooms around a fixed point of the canvas. */
  zoom(by, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    const { camera, canvas } = this;
    const [row, col] = this.cellAt(x, y);
    camera.scale = Math.max(0.5, Math.min(80, camera.scale * by));
    camera.fits = false;
    this.page.nameFit();
    camera.row = row - (y - canvas.height / 2) / camera.scale;
    camera.col = col - (x - canvas.width / 2) / camera.scale;
    this.page.draw();
  }

  cellAt(x, y) {
    const {
      camera: { row, col, scale },
      canvas,
    } = this;
    return [row + (y - canvas.height / 2) / scale, col + (x - canvas.width / 2) / scale];
  }

  pixelAt(row, col) {
    const { camera, canvas } = this;
    return [
      (col - camera.col) * camera.scale + canvas.width / 2,
      (row - camera.row) * camera.scale + canvas.height / 2,
    ];
  }

  /** Returns the position of an agent, interpolated between cells while the city moves. */
  place(agent) {
    const { tick, part } = this.now;
    const [from, to] = [this.run.at(tick, agent), this.run.at(tick + 1, agent)];
    const share = this.stillMotion ? 0 : part;
    return [from[0] + (to[0] - from[0]) * share + 0.5, from[1] + (to[1] - from[1]) * share + 0.5];
  }

  /** Returns the rotation of a car, interpolated like its position. */
  turn(agent) {
    const { tick, part } = this.now;
    const [from, to] = [TURNS[this.run.facing(tick, agent)], TURNS[this.run.facing(tick + 1, agent)]];
    const by = Math.atan2(Math.sin(to - from), Math.cos(to - from));
    return from + (this.stillMotion ? 0 : part) * by;
  }

  agentAt(x, y) {
    let [nearest, found] = [Math.max(3 * this.camera.scale, 14 * pixelUnit()), -1];
    for (let agent = 0; agent < this.run.agents; agent += 1) {
      const [px, py] = this.pixelAt(...this.place(agent));
      const distance = Math.hypot(px - x, py - y);
      if (distance < nearest) [nearest, found] = [distance, agent];
    }
    return found;
  }

  listen() {
    const { canvas, camera } = this;
    const held = new Map();
    let moved = false;
    const point = (event) => {
      const box = canvas.getBoundingClientRect();
      const scale = canvas.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, point(event));
      moved = held.size > 1;
    });
    canvas.addEventListener("pointermove", (event) => {
      const here = point(event);
      const before = held.get(event.pointerId);
      if (!before) {
        const agent = this.agentAt(...here);
        canvas.style.cursor = agent < 0 ? "grab" : "pointer";
        canvas.title = agent < 0 ? "" : this.caption(agent);
        return;
      }
      if (!moved && Math.hypot(here[0] - before[0], here[1] - before[1]) < 5) return;
      moved = true;
      const others = [...held].filter(([id]) => id !== event.pointerId);
      held.set(event.pointerId, here);
      if (others.length) {
        const [, [ox, oy]] = others[0];
        const spread = ([x, y]) => Math.hypot(x - ox, y - oy) || 1;
        this.zoom(spread(here) / spread(before), ox, oy);
        return;
      }
      camera.row -= (here[1] - before[1]) / camera.scale;
      camera.col -= (here[0] - before[0]) / camera.scale;
      camera.fits = false;
      this.page.nameFit();
      this.page.setFollow(false);
      this.page.draw();
    });
    const release = (event) => {
      if (!held.delete(event.pointerId) || held.size) return;
      if (!moved && event.type === "pointerup") this.page.choose({ agent: this.agentAt(...point(event)) });
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...point(event));
      },
      { passive: false },
    );
  }

  /** Returns the name of an agent with its concepts and action. */
  caption(agent) {
    const { id, concepts } = this.run.data.agents[agent];
    return `${[id, ...concepts].join(" ")}: ${this.run.action(this.now.tick, agent)}`;
  }

  /** Returns where the ground is on the canvas. */
  frame() {
    const [x, y] = this.pixelAt(0, 0);
    return { x, y, scale: this.camera.scale, width: this.canvas.width, height: this.canvas.height };
  }

  draw() {
    const { canvas, below } = this;
    const paint = canvas.getContext("2d");
    const frame = this.frame();
    const key = JSON.stringify([frame, isDark()]);
    if (key !== this.groundKey) {
      [below.width, below.height] = [canvas.width, canvas.height];
      const ground = below.getContext("2d");
      ground.imageSmoothingQuality = "high";
      this.scenery.ground.draw(ground, frame);
      this.groundKey = key;
    }
    paint.drawImage(below, 0, 0);
    paint.imageSmoothingQuality = "high";
    this.drawAgents(paint);
  }

  /** Draws all agents, and what belongs to the chosen one. */
  drawAgents(paint) {
    const { tick, agent, clause, of } = this.now;
    if (agent >= 0) this.drawChoice(paint, tick, agent);
    // Pedestrians cover cars, as in pictures; the chosen agent covers all.
    const rank = (one) => 2 * (one === agent) + (this.run.data.agents[one].kind === "Pedestrian");
    const order = this.run.data.agents.map((_, one) => one).sort((a, b) => rank(a) - rank(b));
    const different = this.page.difference?.at(tick);
    const { roster } = this.page;
    const isOther = (one) =>
      (clause >= 0 && of === this.number && !this.run.fired(tick, one).includes(clause)) ||
      (roster.isFiltered && !roster.has(one, tick));
    for (const one of order) {
      const faint = one !== agent && isOther(one);
      paint.globalAlpha = faint ? 0.35 : 1;
      this.drawAgent(paint, one, different);
      paint.globalAlpha = 1;
    }
    for (const one of order) this.drawLabel(paint, one);
  }

  /** Draws field of view, remaining route, goal and partners of the chosen agent. */
  drawChoice(paint, tick, agent) {
    const color = COLORS[this.run.action(tick, agent)];
    const { scale } = this.camera;
    const unit = pixelUnit();
    const [top, left, bottom, right] = this.run.view(tick, agent);
    const [x, y] = this.pixelAt(top, left);
    const size = [(right + 1 - left) * scale, (bottom + 1 - top) * scale];
    paint.fillStyle = "#ffffff2e";
    paint.fillRect(x, y, ...size);
    paint.strokeStyle = isDark() ? "#ffffffb0" : "#1d2026b0";
    paint.lineWidth = 1.5 * unit;
    paint.setLineDash([6 * unit, 4 * unit]);
    paint.strokeRect(x, y, ...size);
    paint.setLineDash([]);
    const way = this.run.wayAhead(tick, agent);
    paint.lineJoin = "round";
    if (way.length) {
      for (const [ink, wide] of [
        ["#ffffffc0", Math.max(5 * unit, scale)],
        [color, Math.max(2.5 * unit, 0.5 * scale)],
      ]) {
        paint.strokeStyle = ink;
        paint.lineWidth = wide;
        paint.beginPath();
        way.forEach(([row, col], at) => {
          const point = this.pixelAt(row + 0.5, col + 0.5);
          if (at) paint.lineTo(...point);
          else paint.moveTo(...point);
        });
        paint.stroke();
      }
    }
    const [row, col] = this.run.goal(tick, agent);
    paint.beginPath();
    paint.arc(...this.pixelAt(row + 0.5, col + 0.5), Math.max(5 * unit, scale), 0, 2 * Math.PI);
    paint.fillStyle = color;
    paint.fill();
    paint.strokeStyle = "#ffffff";
    paint.lineWidth = 2 * unit;
    paint.stroke();
    const here = this.pixelAt(...this.place(agent));
    for (const partner of this.run.partners(tick, agent)) {
      const there = this.pixelAt(...this.place(partner));
      for (const [ink, wide] of [
        ["#ffffffc0", 5 * unit],
        [color, 2.5 * unit],
      ]) {
        paint.strokeStyle = ink;
        paint.lineWidth = wide;
        paint.beginPath();
        paint.moveTo(...here);
        paint.lineTo(...there);
        paint.stroke();
        paint.beginPath();
        paint.arc(...there, Math.max(3.6 * scale, 13 * unit), 0, 2 * Math.PI);
        paint.stroke();
      }
    }
  }

  /** Returns the side of an agent, in canvas pixels. */
  side(kind) {
    const [cells, least] = SIDES[kind];
    return Math.max(cells * this.camera.scale, least * pixelUnit());
  }

  drawAgent(paint, agent, different) {
    const { kind } = this.run.data.agents[agent];
    const { tick, hover } = this.now;
    const unit = pixelUnit();
    const [x, y] = this.pixelAt(...this.place(agent));
    const { width, height } = this.canvas;
    const side = this.side(kind);
    if (x < -2 * side || y < -2 * side || x > width + 2 * side || y > height + 2 * side) return;
    const color = COLORS[this.run.action(tick, agent)];
    const radius = (kind === "Car" ? 0.95 : 0.62) * side;
    const ring = (color, wide, dash = [], by = 1) => {
      paint.beginPath();
      paint.arc(x, y, by * radius, 0, 2 * Math.PI);
      paint.strokeStyle = color;
      paint.lineWidth = wide * unit;
      paint.setLineDash(dash.map((length) => length * unit));
      paint.stroke();
      paint.setLineDash([]);
    };
    // The action: a disc under the icon, and a dot beside it.
    paint.beginPath();
    paint.arc(x, y, radius, 0, 2 * Math.PI);
    paint.fillStyle = `${color}59`;
    paint.fill();
    if (agent === this.now.agent || agent === hover) {
      ring("#ffffff", 5);
      ring("#000000", 2.5);
    }
    const driven = this.run.driven(tick, agent);
    if (driven) {
      ring("#ffffff", 4, [], 1.15);
      ring(driven.broken.length ? COLORS.Stop : "#000000", 2.5, driven.broken.length ? [] : [5, 3], 1.15);
    }
    if (different?.acts.includes(agent) || different?.apart.includes(agent)) {
      ring("#ffffff", 5, [], 1.3);
      ring(DIFFERENT, 3, different.acts.includes(agent) ? [] : [3, 3], 1.3);
    }
    const car = kind === "Car";
    const icons = this.scenery.icons[agent];
    const facing = Math.max(this.run.data.headings.indexOf(this.run.facing(tick, agent)), 0);
    const atlas = car ? this.scenery.cars : this.scenery.pedestrians;
    atlas.draw(paint, car ? icons[0] : icons[facing], x, y, side, car ? this.turn(agent) : 0);
    const dot = Math.max(3.2 * unit, 0.16 * side);
    paint.beginPath();
    paint.arc(x + 0.72 * radius, y - 0.72 * radius, dot, 0, 2 * Math.PI);
    paint.fillStyle = color;
    paint.fill();
    paint.strokeStyle = "#ffffff";
    paint.lineWidth = 1.2 * unit;
    paint.stroke();
  }

  /** Names the chosen agent, and all agents of a map that is large enough. */
  drawLabel(paint, agent) {
    const { id, kind, concepts } = this.run.data.agents[agent];
    const unit = pixelUnit();
    const chosen = agent === this.now.agent || agent === this.now.hover;
    if (!chosen && this.camera.scale < 7 * unit) return;
    const [x, y] = this.pixelAt(...this.place(agent));
    paint.font = `${chosen ? 600 : 400} ${12 * unit}px system-ui, sans-serif`;
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    const words = [id, ...concepts].join(" ");
    const wide = paint.measureText(words).width + 8 * unit;
    // A label stays on the canvas.
    const { width, height } = this.canvas;
    const inside = (at, half, end) => Math.max(half, Math.min(end - half, at));
    const middle = inside(x, wide / 2, width);
    const below = inside(y + (kind === "Car" ? 1 : 0.7) * this.side(kind) + 10 * unit, 9 * unit, height);
    if (Math.abs(middle - x) > wide || Math.abs(below - y) > 3 * this.side(kind) + 20 * unit) return;
    paint.fillStyle = isDark() ? "#000000c8" : "#ffffffdc";
    paint.fillRect(middle - wide / 2, below - 9 * unit, wide, 18 * unit);
    paint.fillStyle = isDark() ? "#ffffff" : "#000000";
    paint.fillText(words, middle, below);
  }
}
