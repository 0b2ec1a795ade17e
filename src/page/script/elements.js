// Helpers that all parts of the page share.

const COLORS = { Slow: "#b87a00", Normal: "#0a8a63", Fast: "#3f7fb5", Stop: "#c8401a" };
const $ = (id) => document.getElementById(id);

/** Returns an element with attributes and children. Text is never parsed as markup. */
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child != null));
  return element;
}

function isDark() {
  const theme = document.documentElement.dataset.theme;
  return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

/** Returns the number of canvas pixels per page pixel. */
function pixelUnit() {
  return window.devicePixelRatio || 1;
}
