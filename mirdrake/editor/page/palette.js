// The palette: tiles of everything that can be dropped on the map.

import { make } from "./map.js";
import { make_draggable } from "./gestures.js";

const PLACES = [{ what: "start", name: "start" }, { what: "goal", name: "goal" }];

function picture(tile) {
  if (tile.what === "start" || tile.what === "goal") {
    const icon = make("svg", { viewBox: "-7 -5 14 10" });
    if (tile.what === "start") make("path", { d: "M-4.5 -1.2H0V-3L4.5 0L0 3V1.2H-4.5Z", fill: "#1f6feb" }, icon);
    else make("circle", { r: 3.4, fill: "#2f9e55", "fill-opacity": 0.35, stroke: "#2f9e55", "stroke-width": 0.6 }, icon);
    return icon;
  }
  const image = new Image(56, 40);
  image.draggable = false;
  image.alt = "";
  image.src = `palette/${tile.what}/${encodeURIComponent(tile.name)}.png`;
  return image;
}

export function show_palette(box, entries, map, options, drop) {
  const tile_of = (tile) => {
    const node = document.createElement("div"), icon = picture(tile);
    node.className = "tile";
    node.dataset.name = tile.what === "actor" ? `actor ${tile.name}` : tile.name;
    node.title = `${tile.name}: drag it onto the map`;
    // What cannot be placed alone has no picture.
    icon.addEventListener("error", () => node.remove());
    node.append(icon, tile.name.replaceAll("_", " "));
    make_draggable(node, map, options, (x, y) => drop(tile, x, y));
    return node;
  };
  const section = (title, tiles) => {
    if (!tiles.length) return;
    const head = document.createElement("h2"), grid = document.createElement("div");
    head.textContent = title;
    grid.className = "tiles";
    grid.append(...tiles.map(tile_of));
    box.append(head, grid);
  };
  box.replaceChildren();
  section("Places", PLACES);
  section("Props", entries.filter((entry) => entry.what === "prop"));
  section("Actors", entries.filter((entry) => entry.what === "actor"));
  section("Groups", entries.filter((entry) => entry.what === "group"));
}
