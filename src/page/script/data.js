// The data of the page: parts that are unpacked one after the other.

/** Decodes base 64. */
function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let at = 0; at < letters.length; at += 1) bytes[at] = letters.charCodeAt(at);
  return bytes;
}

/** Decodes base 64, decompresses, and parses JSON. */
async function unpack(text) {
  const stream = new Blob([bytesOf(text.trim())]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

/** Lets the browser draw. */
function pause() {
  return new Promise((done) => setTimeout(done, 0));
}

/** The parts of the page that are not unpacked yet. */
class Parts {
  constructor() {
    this.waiting = [...document.querySelectorAll("script.data")];
    this.total = this.waiting.reduce((sum, part) => sum + part.textContent.length, 0);
    this.done = 0;
  }

  /** Unpacks all parts of a kind in order, and passes each with the number of its run. */
  async each(kind, use) {
    const parts = this.waiting.filter((part) => part.dataset.kind === kind);
    this.waiting = this.waiting.filter((part) => part.dataset.kind !== kind);
    for (const part of parts) {
      const text = part.textContent;
      part.remove();
      use(await unpack(text), Number(part.dataset.run));
      this.done += text.length;
      $("loading").value = this.done / this.total;
      await pause();
    }
  }
}

/** Icons of one size in a picture. */
class Atlas {
  constructor(data, picture) {
    Object.assign(this, data, { picture });
  }

  /** Decodes the picture; returns `null` without data. */
  static async of(data) {
    if (!data) return null;
    return new Atlas(data, await createImageBitmap(new Blob([bytesOf(data.png)], { type: "image/png" })));
  }

  /** Returns the corner of an icon in the picture. */
  corner(icon) {
    return [(icon % this.columns) * this.side, Math.floor(icon / this.columns) * this.side];
  }

  /** Draws an icon around a point, with the given size in pixels and rotation in radians. */
  draw(paint, icon, x, y, size, turn = 0) {
    const side = (this.side * size) / this.size;
    if (paint.drawSprite) return paint.drawSprite(this, icon, x, y, side, turn);
    paint.save();
    paint.translate(x, y);
    paint.rotate(turn);
    paint.drawImage(this.picture, ...this.corner(icon), this.side, this.side, -side / 2, -side / 2, side, side);
    paint.restore();
  }
}
