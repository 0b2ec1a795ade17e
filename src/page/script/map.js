// The map: the city from above.

/** The clockwise rotation of an icon that faces up, in radians. */
const TURNS = { Up: 0, Right: Math.PI / 2, Down: Math.PI, Left: -Math.PI / 2 };

class CityMap {
  constructor(run, page, icons) {
    Object.assign(this, { run, page, icons, data: run.data, now: page.now });
    this.stillMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.camera = null;
    this.drawGround();
    this.listen();
  }

  /** Draws the ground once. The cell size shrinks so that a large city fits a canvas. */
  drawGround() {
    const { rows, cols, ground, kinds } = this.data.map;
    const dark = isDark();
    const [other, walking, traffic, crossing, line, house, office, garage, store, station] = dark
      ? ["#1b2a20", "#4a4d52", "#2c2f34", "#5b5e52", "#c9a400", "#6b4438", "#3d5266", "#55565e", "#6a5a2f", "#6a3550"]
      : ["#cfe0c3", "#e6e2d8", "#a9adb3", "#d4d0b4", "#ffd700", "#c98f78", "#8fa9c2", "#a6a3ad", "#d8bd6d", "#c987a6"];
    const colours = [other, walking, traffic, crossing, line, house, office, garage, store, station];
    const size = Math.max(1, Math.min(8, Math.floor(4096 / Math.max(rows, cols))));
    const canvas = new OffscreenCanvas(cols * size, rows * size);
    const paint = canvas.getContext("2d");
    ground.forEach((runs, row) => {
      let col = 0;
      for (let at = 0; at < runs.length; at += 2) {
        const [kind, length] = [runs[at], runs[at + 1]];
        paint.fillStyle = colours[kind];
        paint.fillRect(col * size, row * size, length * size, size);
        if (kind === 3) {
          paint.fillStyle = dark ? "#85887a" : "#ffffff";
          for (let cell = col; cell < col + length; cell += 1) if ((cell + row) % 2) paint.fillRect(cell * size, row * size, size, size);
        }
        col += length;
      }
    });
    this.ground = { canvas, size };
    this.buildings = this.findBuildings(kinds);
  }

  /** Returns the rectangles and names of the buildings. */
  findBuildings(kinds) {
    const found = new Map();
    const done = [];
    this.data.map.ground.forEach((runs, row) => {
      let col = 0;
      const here = new Set();
      for (let at = 0; at < runs.length; at += 2) {
        const [kind, length] = [runs[at], runs[at + 1]];
        if (kind >= 5) {
          const key = `${kind} ${col} ${length}`;
          here.add(key);
          if (found.has(key)) found.get(key).rows += 1;
          else found.set(key, { name: kinds[kind], row, col, rows: 1, cols: length });
        }
        col += length;
      }
      for (const [key, building] of found) {
        if (!here.has(key)) {
          done.push(building);
          found.delete(key);
        }
      }
    });
    return [...done, ...found.values()];
  }

  resize() {
    const canvas = $("map");
    const scale = pixelUnit();
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * scale));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (!this.camera || this.camera.whole) this.showWhole();
    else this.draw();
  }

  showWhole() {
    // Frames the region that agents visit; the reader can pan to the rest.
    const cells = this.data.ticks.flatMap(({ at }) => at);
    const spread = (axis, most) => {
      const values = cells.map((cell) => cell[axis]);
      const [low, high] = [values.reduce((a, b) => Math.min(a, b)) - 8, values.reduce((a, b) => Math.max(a, b)) + 8];
      return [Math.max(low, 0), Math.min(high, most)];
    };
    const [top, bottom] = spread(0, this.data.map.rows);
    const [left, right] = spread(1, this.data.map.cols);
    const { width, height } = $("map");
    const scale = Math.min(width / (right - left), height / (bottom - top));
    this.camera = { row: (top + bottom) / 2, col: (left + right) / 2, scale, whole: true };
    this.now.follow = false;
    $("follow").setAttribute("aria-pressed", false);
    this.draw();
  }

  /** Zooms around a fixed point of the canvas. */
  zoom(by, x = $("map").width / 2, y = $("map").height / 2) {
    const { camera } = this;
    const [row, col] = this.cellAt(x, y);
    camera.scale = Math.max(0.5, Math.min(80, camera.scale * by));
    camera.whole = false;
    camera.row = row - (y - $("map").height / 2) / camera.scale;
    camera.col = col - (x - $("map").width / 2) / camera.scale;
    this.draw();
  }

  cellAt(x, y) {
    const { row, col, scale } = this.camera;
    return [row + (y - $("map").height / 2) / scale, col + (x - $("map").width / 2) / scale];
  }

  pixelAt(row, col) {
    const { camera } = this;
    return [(col - camera.col) * camera.scale + $("map").width / 2, (row - camera.row) * camera.scale + $("map").height / 2];
  }

  /** Returns the position of an agent, interpolated between cells while the city moves. */
  place(agent) {
    const { tick, part } = this.now;
    const [from, to] = [this.run.at(tick, agent), this.run.at(tick + 1, agent)];
    const share = this.stillMotion ? 0 : part;
    return [from[0] + (to[0] - from[0]) * share + 0.5, from[1] + (to[1] - from[1]) * share + 0.5];
  }

  agentAt(x, y) {
    const near = this.data.agents.map((_, agent) => {
      const [px, py] = this.pixelAt(...this.place(agent));
      return [Math.hypot(px - x, py - y), agent];
    });
    const [distance, agent] = near.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity, -1]);
    return distance < Math.max(3 * this.camera.scale, 14 * pixelUnit()) ? agent : -1;
  }

  listen() {
    new ResizeObserver(() => this.resize()).observe($("stage"));
    const canvas = $("map");
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
        canvas.style.cursor = this.agentAt(...here) < 0 ? "grab" : "pointer";
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
      this.camera.row -= (here[1] - before[1]) / this.camera.scale;
      this.camera.col -= (here[0] - before[0]) / this.camera.scale;
      this.camera.whole = false;
      this.now.follow = false;
      $("follow").setAttribute("aria-pressed", false);
      this.draw();
    });
    const release = (event) => {
      if (!held.delete(event.pointerId) || held.size) return;
      if (!moved && event.type === "pointerup") this.page.choose({ agent: this.agentAt(...point(event)) });
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...point(event));
    }, { passive: false });
  }

  /** Keeps the map in view. */
  clamp() {
    const { camera, data: { map } } = this;
    const keep = (at, pixels, cells) => {
      const half = pixels / camera.scale / 2;
      return 2 * half >= cells ? cells / 2 : Math.max(half, Math.min(cells - half, at));
    };
    camera.row = keep(camera.row, $("map").height, map.rows);
    camera.col = keep(camera.col, $("map").width, map.cols);
  }

  draw() {
    if (!this.camera) return;
    const { tick, agent, clause, follow } = this.now;
    if (follow && agent >= 0) [this.camera.row, this.camera.col] = this.place(agent);
    this.clamp();
    const canvas = $("map");
    const paint = canvas.getContext("2d");
    paint.clearRect(0, 0, canvas.width, canvas.height);
    const [x, y] = this.pixelAt(0, 0);
    const { scale } = this.camera;
    paint.imageSmoothingEnabled = scale < this.ground.size;
    paint.drawImage(this.ground.canvas, x, y, this.data.map.cols * scale, this.data.map.rows * scale);
    if (scale > 5) this.nameBuildings(paint);
    if (agent >= 0) this.drawChoice(paint, tick, agent);
    // Draws the chosen agent last, above the others.
    const order = this.data.agents.map((_, one) => one).filter((one) => one !== agent);
    if (agent >= 0) order.push(agent);
    order.forEach((one) => {
      const fired = clause < 0 || this.data.ticks[tick].fired[one].includes(clause);
      paint.globalAlpha = fired || one === agent ? 1 : 0.35;
      this.drawAgent(paint, one);
      paint.globalAlpha = 1;
    });
  }

  nameBuildings(paint) {
    const { scale } = this.camera;
    paint.fillStyle = isDark() ? "#ffffff90" : "#00000080";
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    paint.font = `${Math.min(1.6 * scale, 22)}px system-ui, sans-serif`;
    for (const { name, row, col, rows, cols } of this.buildings) {
      paint.fillText(name, ...this.pixelAt(row + rows / 2, col + cols / 2));
    }
  }

  /** Draws field of view, remaining route, goal and partners of the chosen agent. */
  drawChoice(paint, tick, agent) {
    const { view, goal } = this.data.ticks[tick];
    const colour = COLORS[this.run.action(tick, agent)];
    const { scale } = this.camera;
    const unit = pixelUnit();
    const [top, left, bottom, right] = view[agent];
    const [x, y] = this.pixelAt(top, left);
    const size = [(right + 1 - left) * scale, (bottom + 1 - top) * scale];
    paint.fillStyle = isDark() ? "#ffffff14" : "#1f5fbf16";
    paint.fillRect(x, y, ...size);
    paint.strokeStyle = isDark() ? "#ffffff80" : "#1f5fbf90";
    paint.lineWidth = 1.5 * unit;
    paint.setLineDash([6 * unit, 4 * unit]);
    paint.strokeRect(x, y, ...size);
    paint.setLineDash([]);
    const way = this.run.wayAhead(tick, agent);
    if (way.length) {
      paint.strokeStyle = colour;
      paint.globalAlpha = 0.55;
      paint.lineWidth = Math.max(2 * unit, 0.6 * scale);
      paint.lineJoin = "round";
      paint.beginPath();
      way.forEach(([row, col], at) => {
        const point = this.pixelAt(row + 0.5, col + 0.5);
        if (at) paint.lineTo(...point);
        else paint.moveTo(...point);
      });
      paint.stroke();
      paint.globalAlpha = 1;
    }
    const [gx, gy] = this.pixelAt(goal[agent][0] + 0.5, goal[agent][1] + 0.5);
    paint.fillStyle = colour;
    paint.beginPath();
    paint.arc(gx, gy, Math.max(4 * unit, scale), 0, 2 * Math.PI);
    paint.fill();
    const here = this.pixelAt(...this.place(agent));
    paint.lineWidth = 2.5 * unit;
    paint.strokeStyle = colour;
    for (const partner of this.run.partners(tick, agent)) {
      const there = this.pixelAt(...this.place(partner));
      paint.beginPath();
      paint.moveTo(...here);
      paint.lineTo(...there);
      paint.stroke();
      paint.beginPath();
      paint.arc(...there, Math.max(3.4 * scale, 12 * unit), 0, 2 * Math.PI);
      paint.stroke();
    }
  }

  /** Draws a dashed ring around a driven agent, solid and red where its action violates a clause. */
  drawDriven(paint, x, y, side, { broken }) {
    const unit = pixelUnit();
    paint.beginPath();
    paint.arc(x, y, 0.55 * side, 0, 2 * Math.PI);
    paint.lineWidth = 2.5 * unit;
    paint.strokeStyle = broken.length ? COLORS.Stop : isDark() ? "#fff" : "#000";
    paint.setLineDash(broken.length ? [] : [5 * unit, 3 * unit]);
    paint.stroke();
    paint.setLineDash([]);
  }

  drawAgent(paint, agent) {
    const { kind, concepts, id, icons } = this.data.agents[agent];
    const { tick } = this.now;
    const { scale } = this.camera;
    const unit = pixelUnit();
    const [x, y] = this.pixelAt(...this.place(agent));
    const heading = this.data.ticks[tick].heading[agent];
    const chosen = agent === this.now.agent || agent === this.now.hover;
    const car = kind === "Car";
    const side = Math.max((car ? 7 : 5) * scale, (car ? 26 : 20) * unit);
    const colour = COLORS[this.run.action(tick, agent)];
    // The action: a disc under the icon, with a rim visible on any ground.
    paint.beginPath();
    paint.arc(x, y, 0.42 * side, 0, 2 * Math.PI);
    paint.fillStyle = `${colour}70`;
    paint.fill();
    paint.strokeStyle = chosen ? (isDark() ? "#fff" : "#000") : colour;
    paint.lineWidth = (chosen ? 3 : 2) * unit;
    paint.stroke();
    const driven = this.run.driven(tick, agent);
    if (driven) this.drawDriven(paint, x, y, side, driven);
    paint.save();
    paint.translate(x, y);
    if (car) paint.rotate(TURNS[this.data.headings[heading]] ?? 0);
    paint.imageSmoothingEnabled = true;
    paint.imageSmoothingQuality = "high";
    const icon = this.icons[car ? icons[0] : icons[Math.max(heading, 0)]];
    paint.drawImage(icon, -side / 2, -side / 2, side, side);
    paint.restore();
    if (scale > 5 * unit || chosen) {
      paint.font = `${chosen ? 600 : 400} ${12 * unit}px system-ui, sans-serif`;
      paint.textAlign = "center";
      paint.textBaseline = "top";
      const words = [id, ...concepts].join(" ");
      const [width, below] = [paint.measureText(words).width, y + 0.45 * side];
      paint.fillStyle = isDark() ? "#000000b0" : "#ffffffc8";
      paint.fillRect(x - width / 2 - 3 * unit, below - 2 * unit, width + 6 * unit, 16 * unit);
      paint.fillStyle = isDark() ? "#fff" : "#000";
      paint.fillText(words, x, below);
    }
  }
}
