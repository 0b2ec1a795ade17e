// Bars between the parts of the page, which the reader moves.

/** Where the browser remembers the bars. */
const SPLITS = "logicity-splits";

/** The least and the greatest share of a part, in percent. */
const SHARES = [15, 75];

/** Returns the shares that the browser remembers, by variable. */
function rememberedShares() {
  try {
    const shares = JSON.parse(localStorage.getItem(SPLITS));
    return shares && typeof shares === "object" ? shares : {};
  } catch {
    // Some browsers keep nothing for files, or forbid it.
    return {};
  }
}

function rememberShare(name, share) {
  try {
    localStorage.setItem(SPLITS, JSON.stringify({ ...rememberedShares(), [name]: share }));
  } catch {
    // The bar keeps its place until the page is closed.
  }
}

/** A bar that moves by pointer and keys. It sets a variable of the style: the share of the part below or beside the map. */
class Split {
  constructor(name) {
    Object.assign(this, { name, bar: $(`split-${name}`), main: document.querySelector("main") });
    this.isAcross = this.bar.getAttribute("aria-orientation") === "vertical";
    const [least, most] = SHARES;
    this.bar.setAttribute("aria-valuemin", 100 - most);
    this.bar.setAttribute("aria-valuemax", 100 - least);
    const share = rememberedShares()[name];
    if (Number.isFinite(share)) this.set(share);
    this.listen();
    new ResizeObserver(() => this.describe()).observe($("viewer"));
  }

  /** Returns the length of the page along which the bar moves, in pixels. */
  get length() {
    const style = getComputedStyle(this.main);
    const sides = this.isAcross ? ["Left", "Right"] : ["Top", "Bottom"];
    const padding = sides.reduce((sum, side) => sum + parseFloat(style[`padding${side}`]), 0);
    return (this.isAcross ? this.main.clientWidth : this.main.clientHeight) - padding;
  }

  /** Returns the present share of the second part, in percent. */
  get share() {
    const size = (element) => element.getBoundingClientRect()[this.isAcross ? "width" : "height"];
    // On small screens the bar lies over its parts.
    const bar = getComputedStyle(this.main).display === "grid" ? size(this.bar) : 0;
    return 100 - (100 * (size($("viewer")) + bar)) / this.length;
  }

  /** Moves the bar; without a share, back to where the page had it. */
  set(share) {
    const [least, most] = SHARES;
    const kept = share === undefined ? undefined : Math.max(least, Math.min(most, share));
    if (kept === undefined) this.main.style.removeProperty(`--${this.name}`);
    else this.main.style.setProperty(`--${this.name}`, `${kept.toFixed(2)}%`);
    return kept;
  }

  /** Moves the bar for good. */
  move(share) {
    rememberShare(this.name, this.set(share));
    this.describe();
  }

  describe() {
    this.bar.setAttribute("aria-valuenow", Math.round(100 - this.share));
  }

  listen() {
    const { bar } = this;
    const at = (event) => (this.isAcross ? event.clientX : event.clientY);
    let held;
    bar.addEventListener("pointerdown", (event) => {
      bar.setPointerCapture(event.pointerId);
      bar.classList.add("held");
      held = { from: at(event), share: this.share, moved: undefined };
    });
    bar.addEventListener("pointermove", (event) => {
      if (!held || (held.moved === undefined && Math.abs(at(event) - held.from) < 3)) return;
      held.moved = this.set(held.share + (100 * (held.from - at(event))) / this.length);
    });
    for (const end of ["pointerup", "pointercancel"])
      bar.addEventListener(end, () => {
        bar.classList.remove("held");
        if (held?.moved !== undefined) this.move(held.moved);
        held = undefined;
      });
    bar.addEventListener("dblclick", () => this.move());
    bar.addEventListener("keydown", (event) => {
      const by = event.shiftKey ? 10 : 2;
      const [less, more] = this.isAcross ? ["ArrowRight", "ArrowLeft"] : ["ArrowDown", "ArrowUp"];
      const acts = {
        [less]: () => this.move(this.share - by),
        [more]: () => this.move(this.share + by),
        Home: () => this.move(SHARES[1]),
        End: () => this.move(SHARES[0]),
        Enter: () => this.move(),
      };
      if (!acts[event.key]) return;
      acts[event.key]();
      event.preventDefault();
      // The page has other meanings for these keys.
      event.stopPropagation();
    });
  }
}
