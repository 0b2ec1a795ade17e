// The ground: streets, crossings, sidewalks and buildings, drawn at any scale.

/** The colors that a dark page lays over the ground. */
const NIGHT = "#0a0f1a73";

/** Returns the rectangles of a zone and the segments of its outline, as [row, column, rows, columns]. */
function outlined(bands) {
  const [rectangles, outline] = [[], []];
  let [top, above] = [0, []];
  // Where an end of a run has no equal end in the next band, the outline begins or ends.
  const horizontal = (below) => {
    const ends = [...above, ...below].sort((a, b) => a - b);
    for (let at = 0; at < ends.length; at += 2)
      if (ends[at] !== ends[at + 1]) outline.push([top, ends[at], 0, ends[at + 1] - ends[at]]);
  };
  for (const [rows, runs] of [...bands, [0, []]]) {
    const ends = runs.flatMap(([col, cols]) => [col, col + cols]);
    horizontal(ends);
    for (const [col, cols] of runs) rectangles.push([top, col, rows, cols]);
    for (const col of ends) outline.push([top, col, rows, 0]);
    [top, above] = [top + rows, ends];
  }
  return { rectangles, outline };
}

class Ground {
  constructor(map, buildings) {
    Object.assign(this, { map, buildings });
    const { surfaces } = map;
    let top = 0;
    /** Bands of equal rows, with their runs as [surface, marked sides, first column, columns]. */
    this.bands = map.bands.map(([rows, runs]) => {
      let left = 0;
      const band = { top, rows, runs: [] };
      for (const [code, cols] of runs) {
        band.runs.push([surfaces[code % 8], code >> 3, left, cols]);
        left += cols;
      }
      top += rows;
      return band;
    });
    /** The zones, with the rectangles of their cells and the segments of their outlines. */
    this.zones = (map.zones ?? []).map((zone) => ({ ...zone, ...outlined(zone.bands), isShown: true }));
  }

  /** Draws the part of the ground on a picture. `x` and `y` are the pixel of the map's corner. */
  draw(paint, { x, y, scale, width, height }) {
    const { colors, cols, rows } = this.map;
    const place = { across: (col) => Math.round(x + col * scale), down: (row) => Math.round(y + row * scale) };
    paint.fillStyle = colors.meadow;
    paint.fillRect(0, 0, width, height);
    const [left, right] = [Math.max(0, -x / scale), Math.min(cols, (width - x) / scale)];
    const [top, bottom] = [Math.max(0, -y / scale), Math.min(rows, (height - y) / scale)];
    for (const band of this.bands) {
      if (band.top >= bottom || band.top + band.rows <= top) continue;
      for (const run of band.runs) {
        if (run[2] < right && run[2] + run[3] > left) this.drawRun(paint, band, run, place, scale);
      }
    }
    for (const [icon, , row, col, side] of this.map.sites) {
      if (row >= bottom || row + side <= top || col >= right || col + side <= left) continue;
      const [from, to] = [place.across(col), place.across(col + side)];
      this.buildings.draw(paint, icon, (from + to) / 2, (place.down(row) + place.down(row + side)) / 2, to - from);
    }
    if (isDark()) {
      paint.fillStyle = NIGHT;
      paint.fillRect(0, 0, width, height);
    }
    for (const zone of this.zones) if (zone.isShown) this.drawZone(paint, zone, place);
  }

  drawZone(paint, { color, dash, rectangles, outline }, { across, down }) {
    paint.fillStyle = `${color}47`;
    for (const [row, col, rows, cols] of rectangles) {
      const [x, y] = [across(col), down(row)];
      paint.fillRect(x, y, across(col + cols) - x, down(row + rows) - y);
    }
    const unit = pixelUnit();
    paint.strokeStyle = color;
    paint.lineWidth = 2 * unit;
    paint.setLineDash(dash[1] ? dash.map((length) => length * unit) : []);
    paint.beginPath();
    for (const [row, col, rows, cols] of outline) {
      paint.moveTo(across(col), down(row));
      paint.lineTo(across(col + cols), down(row + rows));
    }
    paint.stroke();
    paint.setLineDash([]);
  }

  drawRun(paint, { top, rows }, [surface, sides, left, cols], { across, down }, scale) {
    const { colors } = this.map;
    const fill = (color, row, col, high, wide) => {
      const [from, to] = [across(col), down(row)];
      paint.fillStyle = color;
      paint.fillRect(from, to, Math.max(across(col + wide) - from, 1), Math.max(down(row + high) - to, 1));
    };
    const plain = { meadow: colors.meadow, sidewalk: colors.sidewalk, building: colors.sidewalk };
    fill(plain[surface] ?? colors.asphalt, top, left, rows, cols);
    if (surface === "sidewalk" && scale >= 3) this.drawJoints(paint, top, rows, left, cols, across, down);
    if (sides) {
      const [color, deep] = surface === "sidewalk" ? [colors.curb, 0.2] : [colors.paint, 0.5];
      // In the order of the headings: left, right, up, down.
      if (sides & 1) fill(color, top, left, rows, deep);
      if (sides & 2) fill(color, top, left + cols - deep, rows, deep);
      if (sides & 4) fill(color, top, left, deep, cols);
      if (sides & 8) fill(color, top + rows - deep, left, deep, cols);
    }
    if (surface === "crossing along row")
      for (let col = left + (left % 2); col < left + cols; col += 2) fill(colors.paint, top, col, rows, 1);
    if (surface === "crossing along column")
      for (let row = top + (top % 2); row < top + rows; row += 2) fill(colors.paint, row, left, 1, cols);
    // Dashes are three of five cells long.
    const dashes = (start, length, draw) => {
      for (let at = start - (start % 5); at < start + length; at += 5) {
        const [from, to] = [Math.max(at, start), Math.min(at + 3, start + length)];
        if (from < to) draw(from, to - from);
      }
    };
    if (surface === "mid line along row")
      dashes(left, cols, (col, wide) => fill(colors["mid line"], top + 0.375, col, 0.25, wide));
    if (surface === "mid line along column")
      dashes(top, rows, (row, high) => fill(colors["mid line"], row, left + 0.375, high, 0.25));
  }

  /** Draws the joints between the slabs of a sidewalk, which are five cells wide. */
  drawJoints(paint, top, rows, left, cols, across, down) {
    paint.fillStyle = "#00000014";
    const [x, y] = [across(left), down(top)];
    for (let col = left + ((5 - (left % 5)) % 5); col < left + cols; col += 5)
      paint.fillRect(across(col), y, 1, down(top + rows) - y);
    for (let row = top + ((5 - (top % 5)) % 5); row < top + rows; row += 5)
      paint.fillRect(x, down(row), across(left + cols) - x, 1);
  }
}

/** Returns what maps draw: the ground, and the icons of the agents. */
async function sceneryOf({ map, icons, atlases }) {
  const named = ["car", "pedestrian", "building"].map(async (name, at) => {
    const atlas = await Atlas.of(atlases[at]);
    return atlas && Object.assign(atlas, { name });
  });
  const [cars, pedestrians, buildings] = await Promise.all(named);
  return { ground: new Ground(map, buildings), icons, cars, pedestrians };
}
