// Drawing to SVG with the methods of a canvas, as far as the page uses them.

/** Collects SVG elements. The namespace is that of the icons in the document. */
class SvgPaint {
  constructor(width, height) {
    const { namespaceURI } = document.querySelector("svg");
    this.create = (name, attributes) => {
      const element = document.createElementNS(namespaceURI, name);
      for (const [key, value] of Object.entries(attributes))
        element.setAttribute(key, typeof value === "number" ? this.short(value) : value);
      return element;
    };
    this.root = this.create("svg", { width, height, viewBox: `0 0 ${width} ${height}` });
    this.parents = [this.root];
    this.sprites = new Map();
    this.ruler = new OffscreenCanvas(1, 1).getContext("2d");
    Object.assign(this, {
      fillStyle: "#000",
      strokeStyle: "#000",
      lineWidth: 1,
      globalAlpha: 1,
      lineJoin: "miter",
      dash: [],
    });
    Object.assign(this, { font: "10px sans-serif", textAlign: "start", textBaseline: "alphabetic" });
  }

  short(number) {
    return String(Math.round(number * 100) / 100);
  }

  add(name, attributes) {
    const opacity = this.globalAlpha < 1 ? { opacity: this.globalAlpha } : {};
    const element = this.create(name, { ...attributes, ...opacity });
    this.parents.at(-1).append(element);
    return element;
  }

  /** Begins a part with its own origin, which hides what is outside. A unit has `unit` pixels in the part. */
  pushPart(x, y, width, height, unit) {
    const part = this.create("svg", { x, y, width, height, viewBox: `0 0 ${width * unit} ${height * unit}` });
    this.parents.at(-1).append(part);
    this.parents.push(part);
  }

  popPart() {
    this.parents.pop();
  }

  setLineDash(dash) {
    this.dash = dash;
  }

  get line() {
    const dash = this.dash.length ? { "stroke-dasharray": this.dash.join(" ") } : {};
    return {
      fill: "none",
      stroke: this.strokeStyle,
      "stroke-width": this.lineWidth,
      "stroke-linejoin": this.lineJoin,
      ...dash,
    };
  }

  fillRect(x, y, width, height) {
    this.add("rect", { x, y, width, height, fill: this.fillStyle });
  }

  strokeRect(x, y, width, height) {
    this.add("rect", { x, y, width, height, ...this.line });
  }

  beginPath() {
    this.path = "";
  }

  moveTo(x, y) {
    this.path += `M${this.short(x)} ${this.short(y)}`;
  }

  lineTo(x, y) {
    this.path += `L${this.short(x)} ${this.short(y)}`;
  }

  /** Adds a full circle; the page draws no other arcs. */
  arc(x, y, radius) {
    const [r, left, right, middle] = [radius, x - radius, x + radius, y].map((number) => this.short(number));
    this.path += `M${left} ${middle}A${r} ${r} 0 1 1 ${right} ${middle}A${r} ${r} 0 1 1 ${left} ${middle}Z`;
  }

  fill() {
    this.add("path", { d: this.path, fill: this.fillStyle });
  }

  stroke() {
    this.add("path", { d: this.path, ...this.line });
  }

  measureText(text) {
    this.ruler.font = this.font;
    return this.ruler.measureText(text);
  }

  fillText(text, x, y) {
    const [, weight, size, family] = /^(?:(\d+) )?([\d.]+)px (.*)$/.exec(this.font);
    const anchor = { center: "middle", right: "end", end: "end" }[this.textAlign] ?? "start";
    // Baselines by offset: few editors read other values of `dominant-baseline`.
    const down = { middle: 0.35, top: 0.8 }[this.textBaseline] ?? 0;
    const font = { "font-family": family, "font-size": Number(size), "font-weight": weight ?? "400" };
    this.add("text", { x, y: y + down * size, fill: this.fillStyle, "text-anchor": anchor, ...font }).textContent =
      text;
  }

  /** Draws an icon of an atlas. Each icon is stored once. */
  drawSprite(atlas, icon, x, y, side, turn) {
    const key = `icon-${atlas.name}-${icon}`;
    if (!this.sprites.has(key)) {
      const canvas = make("canvas", { width: atlas.side, height: atlas.side });
      canvas
        .getContext("2d")
        .drawImage(atlas.picture, ...atlas.corner(icon), atlas.side, atlas.side, 0, 0, atlas.side, atlas.side);
      const image = {
        id: key,
        href: canvas.toDataURL(),
        width: atlas.side,
        height: atlas.side,
        x: -atlas.side / 2,
        y: -atlas.side / 2,
      };
      this.sprites.set(key, this.create("image", image));
    }
    const degrees = turn ? ` rotate(${this.short((turn * 180) / Math.PI)})` : "";
    this.add("use", {
      href: `#${key}`,
      transform: `translate(${this.short(x)} ${this.short(y)})${degrees} scale(${(side / atlas.side).toFixed(4)})`,
    });
  }

  /** Returns the file. */
  text() {
    const icons = this.create("defs", {});
    icons.append(...this.sprites.values());
    this.root.prepend(icons);
    return new XMLSerializer().serializeToString(this.root);
  }
}
