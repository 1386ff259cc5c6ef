// The page of `motionkit view`: reads its motions and plays them.

import { Color, Group, Vector3 } from "three";
import { button, element, fillHelp, icon, refused, toggle } from "../lib/dom.js";
import { Clip, Figure, Footprints, Labels, Ribbon, Stage } from "../lib/scene.js";
import { Timeline } from "./timeline.js";

const COLORS = ["#4f86e8", "#e8853d", "#3fae74", "#a873de", "#dd5567", "#2ba7ac", "#c7a227", "#8d97a8"];
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const FAR_OFF = 2.5; // metres of travel beyond which the camera follows a motion
const REACH = 0.9; // metres on either side that a body and its arms take in the picture
// Metres beyond which a motion leaps rather than travels, as captures do whose root is lost; its place beside others; and
// the distance from which the camera leaves it out.
const LEAPS = 300;
const SLOT = 3;
const EYE = 0.9; // metres, height of the camera target
const $ = (id) => document.getElementById(id);

/** Whether a motion covers more ground than anybody walks. */
function leaping({ box }) {
  return Math.max(box[2] - box[0], box[3] - box[1]) > LEAPS;
}

/** The median of the hips along an axis. */
function usual(clip, axis) {
  const values = clip.hips.filter((_, i) => i % 3 === axis).sort();
  return values[values.length >> 1];
}

class Viewer {
  constructor(clips) {
    this.stage = new Stage($("scene"));
    this.labels = new Labels($("labels"), this.stage);
    this.tracks = clips.map((clip, n) => this.#track(clip, COLORS[n % COLORS.length]));
    Object.assign(this, { time: 0, playing: false, looping: true, speed: 1, chosen: 0, apart: clips.length > 1, aside: [0, 0] });
    Object.assign(this, { followed: this.#wanders(), names: false, skeletons: false, paths: true, marks: true });
    this.timeline = new Timeline($("timeline"), this.tracks, (time) => this.seek(time, true));
    this.#controls();
    this.#arrange();
    this.seek(0);
    document.addEventListener("keydown", (event) => this.#key(event));
    const loop = (now) => {
      this.#tick(now);
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  #track(clip, color) {
    const group = new Group();
    const figure = new Figure(clip.rig, new Color(color), this.stage.plain, clip.hero);
    figure.position.y = -clip.floor;
    const way = new Float32Array(clip.frames * 2);
    for (let frame = 0; frame < clip.frames; frame++) {
      way[frame * 2] = clip.hips[frame * 3];
      way[frame * 2 + 1] = clip.hips[frame * 3 + 2];
    }
    const ahead = new Ribbon(way, color, { width: 0.016, opacity: 0.32, height: 0.003 });
    const behind = new Ribbon(way, color, { width: 0.026, opacity: 0.95, height: 0.0035 });
    const paths = [ahead, behind];
    if (clip.path) paths.push(new Ribbon(clip.path, "#f5c542", { width: 0.06, opacity: 0.75, dash: 0.12, height: 0.0025 }));
    const prints = new Footprints(clip);
    group.add(figure, prints, ...paths);
    this.stage.scene.add(group);
    return { clip, color, group, figure, prints, paths, behind, shown: true, frame: -1 };
  }

  get track() {
    return this.tracks[this.chosen];
  }

  #flipTheme() {
    this.stage.flipTheme();
    this.timeline.redraw();
  }

  /** Places motions side by side along x, or all where they were recorded. */
  #arrange() {
    if (!this.followed) this.aside = [0, 0]; // it was that of the arrangement before
    const boxes = this.tracks.map(({ clip }) => clip.box);
    const leaps = this.tracks.map(({ clip }) => leaping(clip));
    const widths = boxes.map((box, n) => (leaps[n] ? SLOT : Math.max(0.9, box[2] - box[0])));
    const whole = widths.reduce((sum, width) => sum + width, 0) + 0.7 * (widths.length - 1);
    let left = -whole / 2;
    this.tracks.forEach(({ clip, group }, n) => {
      const side = this.apart && this.tracks.length > 1;
      const middle = leaps[n] ? usual(clip, 0) : (boxes[n][0] + boxes[n][2]) / 2;
      const start = leaps[n] ? usual(clip, 2) : clip.hips[2];
      group.position.set(side ? left + widths[n] / 2 - middle : 0, 0, side ? -start : 0);
      left += widths[n] + 0.7;
    });
    this.stage.invalidate();
  }

  #wanders() {
    const { box } = this.tracks[0].clip;
    return Math.max(box[2] - box[0], box[3] - box[1]) > FAR_OFF || this.tracks.some(({ clip }) => leaping(clip));
  }

  /** Frames everything visible, or the followed figure. */
  frameAll() {
    this.stage.resize(); // the layout of the page may have changed
    const visible = this.tracks.filter((track) => track.shown);
    const shown = visible.length ? visible : this.tracks;
    const angle = this.tracks.length > 1 ? 0.5 : this.#goodSide(this.track.clip);
    if (this.followed) {
      const { middle, distance } = this.#standBack(this.apart && visible.length ? visible : [this.track], angle);
      const [x, z] = this.#place(this.track);
      this.aside = [middle[0] - x, middle[1] - z];
      this.stage.look(new Vector3(middle[0], EYE, middle[1]), angle, 0.17, distance);
      return;
    }
    const boxes = shown.map(({ clip, group }) => clip.box.map((value, i) => value + (i % 2 ? group.position.z : group.position.x)));
    const low = [0, 1].map((axis) => Math.min(...boxes.map((box) => box[axis])) - 0.5);
    const high = [2, 3].map((axis) => Math.max(...boxes.map((box) => box[axis])) + 0.5);
    const middle = new Vector3((low[0] + high[0]) / 2, EYE, (low[1] + high[1]) / 2);
    const span = Math.hypot(high[0] - low[0], high[1] - low[1]);
    const narrow = Math.max(1, 1.4 / this.stage.camera.aspect);
    this.stage.look(middle, angle, 0.2, Math.max(4.4, span * 1.45) * narrow);
  }

  /** The body's present position on the ground: x, z. */
  #place({ clip, group }) {
    const frame = clip.frameAt(this.time);
    return [clip.middle[frame * 2] + group.position.x, clip.middle[frame * 2 + 1] + group.position.z];
  }

  /** The middle of motions, and the distance at which a camera in this direction sees them all. */
  #standBack(tracks, angle) {
    const { aspect, fov } = this.stage.camera;
    const wide = Math.tan((fov * Math.PI) / 360) * aspect;
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    const here = this.#place(this.track);
    const places = tracks.map((track) => this.#place(track));
    const near = places.filter(([x, z]) => Math.hypot(x - here[0], z - here[1]) < LEAPS);
    const seen = near.map(([x, z]) => [x * cos - z * sin, x * sin + z * cos]);
    const [side, depth] = [0, 1].map((axis) => {
      const values = seen.map((place) => place[axis]);
      return (Math.min(...values) + Math.max(...values)) / 2;
    });
    const needed = seen.map(([across, near]) => (Math.abs(across - side) + REACH) / wide + near - depth);
    const distance = Math.max(3.9, 3.7 / aspect, ...(tracks.length > 1 ? needed : []));
    return { middle: [side * cos + depth * sin, depth * cos - side * sin], distance };
  }

  // Travelling bodies are seen from the side and slightly from the front, others from the front.
  #goodSide(clip) {
    const last = clip.hips.length - 3;
    const way = [clip.hips[last] - clip.hips[0], clip.hips[last + 2] - clip.hips[2]];
    if (Math.hypot(...way) < 1) return 0.55;
    return Math.atan2(way[0], way[1]) + 0.95;
  }

  /** Shows a moment of all motions; a seek by hand also stops playback. */
  seek(time, byHand = false) {
    if (byHand && this.playing) this.play(false);
    this.time = Math.max(0, Math.min(this.timeline.seconds, time));
    for (const track of this.tracks) {
      const frame = track.clip.frameAt(this.time);
      if (frame !== track.frame) this.#pose(track, frame);
    }
    this.timeline.draw(this.time);
    const { clip } = this.track;
    const text = `${this.time.toFixed(2)} s`;
    this.readout.replaceChildren(
      element("b", {}, text),
      element("span", {}, ` / ${this.timeline.seconds.toFixed(2)} s · frame ${clip.frameAt(this.time)} of ${clip.frames}`),
    );
    $("timeline").setAttribute("aria-valuenow", this.time.toFixed(3));
    $("timeline").setAttribute("aria-valuetext", text);
    this.#shadows();
    this.#follow();
  }

  #shadows() {
    const places = this.tracks.filter(({ shown }) => shown).flatMap(({ clip, frame, group }) => [
      clip.hips[frame * 3] + group.position.x,
      clip.hips[frame * 3 + 2] + group.position.z,
    ]);
    if (places.length) this.stage.shadowsAt(places);
  }

  #pose(track, frame) {
    track.frame = frame;
    track.figure.setPose(track.clip.poseAt(frame));
    track.prints.setFrame(frame);
    track.behind.shown = frame + 1;
    this.stage.invalidate();
  }

  #follow() {
    if (!this.followed) return;
    const [x, z] = this.#place(this.track);
    this.stage.follow(x + this.aside[0], this.stage.controls.target.y, z + this.aside[1]);
  }

  #tick(now) {
    const passed = Math.min(0.25, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (this.playing) {
      let time = this.time + passed * this.speed;
      const { seconds } = this.timeline;
      // The last frame is shown as long as the others.
      const end = seconds + Math.min(...this.tracks.map(({ clip }) => 1 / clip.fps));
      if (time >= end) {
        time = this.looping ? (time - end) % end : seconds;
        if (!this.looping) this.play(false);
      }
      this.seek(time);
      this.time = time; // beyond the last frame while that is still shown
    }
    if (this.stage.draw()) this.#label();
  }

  #label() {
    const labels = [];
    this.tracks.forEach(({ clip, group, shown, color }, n) => {
      if (!shown) return;
      const { x, z } = group.position;
      const { places } = clip.pose;
      const spot = (joint) => ({ x: places[joint].x + x, y: places[joint].y - clip.floor, z: places[joint].z + z });
      if (this.names && n === this.chosen) {
        clip.rig.names.forEach((text, joint) => labels.push({ key: `${n}/${joint}`, text, ...spot(joint) }));
      }
      if (this.tracks.length > 1) {
        const top = Math.max(...places.map(({ y }) => y));
        labels.push({ key: `${n}/name`, text: clip.name, name: color, ...spot(clip.rig.hips), y: top - clip.floor + 0.3 });
      }
    });
    this.labels.show(labels);
  }

  play(on = !this.playing) {
    if (on && this.time >= this.timeline.seconds) this.time = 0;
    this.playing = on;
    this.playButton.replaceChildren(icon(on ? "pause" : "play"));
    this.playButton.setAttribute("aria-label", on ? "Pause" : "Play");
  }

  /** Steps the chosen motion by a number of frames, forward or back. */
  step(frames) {
    const { clip } = this.track;
    this.play(false);
    const frame = Math.max(0, Math.min(clip.frames - 1, clip.frameAt(this.time) + frames));
    this.seek(frame / clip.fps);
  }

  choose(n) {
    if (!this.tracks[n]) return;
    this.chosen = n;
    this.aside = [0, 0];
    this.timeline.chosen = n;
    [...$("clips").children].forEach((node, i) => node.classList.toggle("chosen", i === n && this.tracks.length > 1));
    this.timeline.redraw();
    this.seek(this.time);
    this.stage.invalidate();
  }

  show(n, shown) {
    const track = this.tracks[n];
    track.shown = shown;
    track.group.visible = shown;
    $("clips").children[n].classList.toggle("off", !shown);
    this.timeline.redraw();
    this.seek(this.time);
    this.stage.invalidate();
  }

  #controls() {
    this.tracks.forEach(({ clip, color }, n) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = color;
      const facts = `${clip.frames} frames, ${+clip.fps.toFixed(3)} fps, ${clip.rig.count} joints; unit: ${clip.unit}`;
      const pick = button(clip.name, facts, () => this.choose(n), swatch, clip.name, element("span", { className: "facts" }, `${+clip.fps.toFixed(2)} fps`));
      pick.classList.add("pick");
      const box = element("div", { className: "clip" }, pick);
      if (this.tracks.length > 1) {
        const eye = button(`Show or hide ${clip.name}`, "Show or hide", () => this.show(n, !this.tracks[n].shown), icon("eye"));
        eye.classList.add("eye");
        box.append(eye);
      }
      $("clips").append(box);
    });
    this.#tools();
    this.#transport();
  }

  #tools() {
    const change = (name, apply = () => {}) => (value) => {
      this[name] = value;
      apply(value);
      this.stage.invalidate();
    };
    const each = (apply) => (value) => this.tracks.forEach((track) => apply(track, value));
    const poses = each((track, value) => {
      track.figure.skeletonShown = value;
      track.figure.setPose(track.clip.poseAt(track.frame));
    });
    const sides = change("apart", () => {
      this.#arrange();
      this.seek(this.time);
      this.frameAll();
    });
    this.toggles = {
      f: toggle("Follow", "The camera goes along with the chosen motion (F)", this.followed, change("followed", () => this.#follow())),
      s: toggle("Skeleton", "Bones and joints through the body (S)", false, change("skeletons", poses)),
      n: toggle("Names", "Joint names of the chosen motion (N)", false, change("names")),
      p: toggle("Paths", "Way of the root, and the path it was asked to follow (P)", true, change("paths", each((track, value) => track.paths.forEach((path) => (path.visible = value))))),
      c: toggle("Feet", "Contacts, and in pink where a foot slides (C)", true, change("marks", each((track, value) => (track.prints.visible = value)))),
    };
    if (this.tracks.length > 1) this.toggles.o = toggle("Side by side", "Side by side, or all where they were recorded (O)", true, sides);
    $("tools").append(
      ...Object.values(this.toggles).map(({ node }) => node),
      button("Theme", "Dark or light (D)", () => this.#flipTheme(), "◐"),
      button("Help", "Keyboard (H)", () => $("help").showModal(), "?"),
    );
    fillHelp($("help"), "Keyboard", [
      [["Space"], "play or pause"],
      [["←", "→"], "a frame back or on; with Shift a second"],
      [["Home", "End"], "first and last frame"],
      [["−", "+"], "slower, faster"],
      [["L"], "play once or over and over"],
      [["F"], "follow camera"],
      [["R"], "camera as at first"],
      [["S"], "skeleton"],
      [["N"], "joint names"],
      [["P"], "paths"],
      [["C"], "contacts and sliding"],
      [["O"], "side by side or overlaid"],
      [["1", "…", "9"], "choose a motion"],
      [["D"], "dark or light"],
    ]);
  }

  #transport() {
    this.playButton = button("Play", "Play or pause (Space)", () => this.play(), icon("play"));
    this.playButton.classList.add("play");
    this.readout = element("div", { className: "time" });
    this.speeds = element("select", { title: "Speed (− and +)" });
    this.speeds.setAttribute("aria-label", "Speed");
    SPEEDS.forEach((speed) => this.speeds.append(new Option(`${speed}×`, speed, speed === 1, speed === 1)));
    this.speeds.onchange = () => {
      this.speed = Number(this.speeds.value);
      this.speeds.blur();
    };
    this.toggles.l = toggle("Loop", "Over and over (L)", true, (value) => (this.looping = value));
    this.toggles.l.node.replaceChildren(icon("loop"));
    $("transport").append(
      button("First frame", "First frame (Home)", () => this.seek(0, true), icon("first")),
      button("A frame back", "A frame back (←)", () => this.step(-1), icon("back")),
      this.playButton,
      button("A frame on", "A frame on (→)", () => this.step(1), icon("next")),
      this.toggles.l.node,
      this.speeds,
      this.readout,
    );
    $("timeline").setAttribute("aria-valuemin", "0");
    $("timeline").setAttribute("aria-valuemax", this.timeline.seconds.toFixed(3));
  }

  #faster(steps) {
    const n = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.speed) + steps));
    this.speed = SPEEDS[n];
    this.speeds.value = String(this.speed);
  }

  /** Without controls: a click or Space plays and pauses. */
  bare(theme) {
    const canvas = $("scene");
    let at = null;
    canvas.tabIndex = 0;
    canvas.addEventListener("pointerdown", (event) => (at = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      if (at && Math.hypot(event.clientX - at[0], event.clientY - at[1]) < 4) this.play();
    });
    this.stage.controls.enableZoom = false; // the wheel scrolls the surrounding page
    if (theme) this.stage.theme = theme;
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    // Lists and buttons take the keys that operate them.
    if (event.target instanceof HTMLSelectElement || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
    const rate = this.track.clip.fps;
    const actions = {
      " ": () => this.play(),
      ArrowLeft: () => this.step(event.shiftKey ? -Math.round(rate) : -1),
      ArrowRight: () => this.step(event.shiftKey ? Math.round(rate) : 1),
      Home: () => this.seek(0, true),
      End: () => this.seek(this.timeline.seconds, true),
      "-": () => this.#faster(-1),
      "+": () => this.#faster(1),
      "=": () => this.#faster(1),
      r: () => this.frameAll(),
      d: () => this.#flipTheme(),
      h: () => $("help").showModal(),
      "?": () => $("help").showModal(),
    };
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = actions[key] ?? (this.toggles[key] && (() => this.toggles[key].flip()));
    if (action) action();
    else if (key >= "1" && key <= "9") this.choose(Number(key) - 1);
    else return;
    event.preventDefault();
  }
}

async function start() {
  const data = JSON.parse($("data").textContent);
  document.title = data.title;
  document.documentElement.toggleAttribute("data-bare", Boolean(data.bare));
  for (const { hero } of data.motions) if (hero) hero.data = data.characters[hero.file];
  const viewer = new Viewer(await Promise.all(data.motions.map((motion) => Clip.from(motion))));
  viewer.choose(0);
  viewer.frameAll();
  if (data.bare) viewer.bare(data.theme);
  window.motionkit = viewer; // for tests
  viewer.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  document.documentElement.dataset.ready = "true";
}

start().catch((error) => refused("file", error));
