"use strict";

// Helpers that all parts of the page share.

const COLORS = { Slow: "#a06a00", Normal: "#0b7f5b", Fast: "#2f6fb0", Stop: "#c8401a" };
/** The colors of actions that a configuration defines, by turns. */
const OWN_COLORS = ["#8a3fc0", "#0b8a8a", "#c04f94", "#6f553f"];
/** Gives a color to each action that has none. */
function colorActions(actions) {
  actions.forEach((action, index) => (COLORS[action] ??= OWN_COLORS[index % OWN_COLORS.length]));
}
/** Marks where two runs differ. */
const DIFFERENT = "#c2188f";
const $ = (id) => document.getElementById(id);

/**
 * Returns an element with attributes and children. Text is never parsed as markup. The page's policy allows a style that
 * a script sets, not a `style` attribute.
 */
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "style") element.style.cssText = value;
    else if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
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

/** Returns the name of a file without its folder. */
function fileName(path) {
  return path.split("/").pop();
}

/** Returns the id of an element in the pane of a run. The first run has the ids of the document. */
function paneId(name, run) {
  return run ? `${name}-b` : name;
}

/** Adds the elements of a second run: copies of those of the first, with their own ids. */
function addSecondPane() {
  for (const element of document.querySelectorAll("[data-pane]")) {
    const copy = element.cloneNode(true);
    for (const part of [copy, ...copy.querySelectorAll("[id]")]) part.id = paneId(part.id, 1);
    element.after(copy);
  }
}

/** Throws an error if the browser lacks what the page needs. */
function requireBrowser() {
  if (!("DecompressionStream" in window) || !CSS.supports("color", "light-dark(#000, #fff)"))
    throw new Error("the browser is too old; it requires Chromium 123, Firefox 120, Safari 17.5 or later");
}

/** Reports an error that prevents the page from working. */
function showFault(error) {
  $("loading").hidden = true;
  $("fault").hidden = false;
  $("fault").textContent = `Cannot show this page: ${error.message}`;
  throw error;
}
