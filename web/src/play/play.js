// The page of `motionkit play` and `motionkit demo`: shows the characters of a session and steers the user's own.

import { CircleGeometry, Color, Group, Mesh, MeshBasicMaterial, Plane, Quaternion, Raycaster, RingGeometry, Shape, ShapeGeometry, Vector2, Vector3 } from "three";
import { button, element, fillHelp, refused, toggle } from "../lib/dom.js";
import { Chase, Figure, Labels, Pose, Ribbon, Rig, Sheets, Stage, Steering, ThumbStick } from "../lib/scene.js";

const CM = 0.01;
const COLORS = ["#4f86e8", "#e8853d", "#3fae74", "#a873de", "#dd5567", "#2ba7ac", "#c7a227"];
const OTHERS = "#8d97a8";
const PATH_COLOR = "#f5c542";
// Letter keys of popular types; other types have digits only.
const LETTERS = {
  cartwheel: "c", kicking: "k", punching: "u", "jumping-b": "j", backflip: "b", "dance-salsa": "x", handspring: "h",
  "dive-roll": "r", duck: "z", "martial-arts": "m", "jumping-l": "j",
};
const WALK = 130; // cm/s, default walk
const RUN = 330; // cm/s, if the model has no run
const FASTEST_WALK = 200; // cm/s; faster gaits count as runs
const SLOWEST = 40; // cm/s, smallest speed of a stick
const TURNED = 0.03; // radians of change before a new direction is sent
const PATH_STEP = 0.08; // metres between points of a drawn path
const REST = 700; // ms for which the hand must rest to add a stop to a drawn path
const STOP = 2; // seconds of a stop
const SPARE = 1.25; // factor on the time between wishes, which leaves part of the server's message limit to other requests
const EYE = 0.8; // metres, height of the camera target
const $ = (id) => document.getElementById(id);
const standing = (character) => ({ velocity: [0, 0], facing: null, type: null, character });

export class Play {
  /**
   * @param {(listeners: object) => object} connect makes the link to a session, such as that of link.js
   * @param {(play: Play) => Node[]} tools makes additional buttons
   */
  constructor(connect, tools = () => []) {
    this.tools = tools;
    this.rigs = new Map();
    this.stage = new Stage($("scene"));
    this.labels = new Labels($("labels"), this.stage);
    this.chase = new Chase(this.stage);
    this.steering = new Steering();
    this.steering.thumb = new ThumbStick($("stick"));
    this.sheets = new Sheets($("dock"), [{ name: "Types", panel: $("types") }, { name: "More", panel: $("tools") }]);
    this.characters = new Map(); // id -> figure and state on the page
    this.facts = new Map(); // id -> the server's facts
    this.recordedFroms = new Map(); // id -> start of the recording
    this.paths = new Map(); // id -> the ribbon of the path that a character follows; null if it is not shown
    Object.assign(this, { chosen: null, mode: null, touched: null, stroke: null, drawing: false, facing: false, waiting: [], responses: [] });
    this.stage.look(new Vector3(0, EYE, 0), 0.55 + Math.PI, 0.22, 4.4 * Math.max(1, 0.75 / this.stage.camera.aspect));
    $("figures").hidden ||= matchMedia("(max-width: 700px), (max-height: 480px)").matches; // on a small screen they would hide the body
    const head = $("tools").parentElement; // tools in two rows push down what lies below
    new ResizeObserver(() => head.parentElement.style.setProperty("--head", `${head.offsetHeight}px`)).observe(head);
    this.#marker();
    this.#keys();
    this.#mouse();
    this.link = connect({
      hello: (hello) => this.#hello(hello),
      event: (event) => this.#event(event),
      frame: (frame) => this.#frame(frame),
      lost: (fault) => this.#lost(fault),
    });
    const loop = (now) => {
      this.tick(now, performance.now());
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
    setInterval(() => this.#measures(), 250);
  }

  /** The steered character as shown; undefined if there is none. */
  get own() {
    return this.characters.get(this.chosen);
  }

  // ---- server events ----

  #hello(hello) {
    for (const id of [...this.characters.keys()]) this.#remove(id);
    if (this.hello) this.rigs.clear(); // the server may have changed
    Object.assign(this, { hello, chosen: hello.character, waiting: [], sent: null, left: new Map() });
    this.behind = null;
    this.#pace();
    for (const id of [...this.paths.keys()]) this.#forgetPath(id);
    this.#forgetStroke();
    this.#setMode(null);
    this.apart = (1000 * SPARE) / hello.limits.messages_per_second; // ms between wishes: screens may be faster than the server allows
    // Types may have any name, so forward gaits are recognized by their facing.
    const ahead = hello.types
      .filter(({ name, speed, facing }) => hello.steered.includes(name) && speed > SLOWEST && Math.abs(facing) < 0.8)
      .map(({ speed }) => speed);
    const nearness = (speed) => Math.abs(speed - WALK);
    this.speeds = {
      walking: ahead.reduce((best, speed) => (nearness(speed) < nearness(best) ? speed : best), ahead[0]),
      running: Math.max(0, ...ahead.filter((speed) => speed > FASTEST_WALK)),
    };
    this.#controls();
    this.#characters(hello.characters);
    this.loading = true;
    Object.assign($("notice"), { className: "notice above", textContent: "Loading …" });
  }

  /** Shows a body in its first pose before the session begins. */
  async stand(body, { root, rotations }) {
    const rig = await this.#rig(body);
    if (this.hello) return;
    this.standing = new Figure(rig, new Color(COLORS[0]), this.stage.plain);
    this.standing.setPose(rig.newPose().set(rig, rotations, 0, root, 0));
    this.stage.scene.add(this.standing);
    this.stage.shadowsAt([root[0], root[2]]);
    this.stage.invalidate();
    $("notice").className = "notice above";
  }

  #event(event) {
    if (event.event === "characters") this.#characters(event.characters);
    else if (event.event === "arrived") this.#forgetPath(event.character);
    else if (event.event === "recorded") this.#save(event);
    else if (event.event === "pace") {
      this.behind = event.behind ? event : null;
      this.#pace();
    } else if (event.event === "error") {
      this.say(event.message);
      this.#who(); // a refused choice is shown in the list again
    }
  }

  #lost(fault) {
    const why = fault ? `: ${fault}` : "";
    $("notice").textContent = this.hello ? `The connection is lost${why}. Trying again …` : "No answer from the server. Trying again …";
    this.loading = false;
    Object.assign($("notice"), { className: "notice", hidden: false });
  }

  #characters(facts) {
    const before = this.facts;
    this.facts = new Map(facts.map((one) => [one.id, one]));
    for (const { id, body } of facts) { // who gets another body begins anew
      if ((before.get(id)?.body ?? body) === body) continue;
      this.left.delete(id);
      this.#forgetPath(id);
      if (id === this.chosen) this.#forgetAll();
    }
    const mine = facts.filter((one) => one.owner === this.hello.client).map((one) => one.id);
    if (!mine.includes(this.chosen)) this.#take(mine[0] ?? null);
    for (const id of [...this.characters.keys()]) if (!this.facts.has(id)) this.#remove(id);
    for (const id of [...this.paths.keys()]) if (!mine.includes(id)) this.#forgetPath(id);
    this.mine = mine;
    for (const { id, body } of facts) this.#show(id, body);
    this.#who();
  }

  async #show(id, body) {
    const rig = await this.#rig(body).catch(() => null);
    if (!rig || this.facts.get(id)?.body !== body) return; // outdated: the body has changed since
    const place = this.mine.indexOf(id);
    const color = place < 0 ? OTHERS : COLORS[place % COLORS.length];
    const known = this.characters.get(id);
    if (known?.body === body) {
      known.owner = this.facts.get(id).owner;
      if (known.color !== color) known.figure.color = new Color((known.color = color));
      return;
    }
    const hero = await rig.newHero();
    if (this.facts.get(id)?.body !== body) return hero?.dispose();
    this.#remove(id);
    const stands = this.standing?.rig === rig; // this figure is shown already
    const figure = stands ? this.standing : new Figure(rig, new Color(color), this.stage.plain, hero);
    this.standing = null;
    figure.visible = stands; // others are hidden until their first frame
    this.stage.scene.add(figure);
    this.characters.set(id, { id, body, owner: this.facts.get(id).owner, color, figure, rig, pose: new Pose(rig.count) });
  }

  #remove(id) {
    const one = this.characters.get(id);
    if (!one) return;
    one.figure.removeFromParent();
    one.figure.dispose();
    this.characters.delete(id);
    this.stage.invalidate();
  }

  #rig(body) {
    if (!this.rigs.has(body)) this.rigs.set(body, this.link.figure(body).then(Rig.from));
    return this.rigs.get(body);
  }

  #frame(frame) {
    this.newest = frame;
    this.stage.invalidate();
    const own = frame.characters.get(this.chosen);
    if (own) while (this.waiting.length && own.seq >= this.waiting[0].seq) {
      this.waiting[0].number ??= frame.number;
      this.answered = this.waiting.shift();
    }
  }

  // ---- drawing ----

  /** Draws one picture: the browser's time, and the moment (ms) to show. */
  tick(now, moment) {
    const passed = Math.min(0.1, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (!this.hello) {
      this.stage.draw();
      return;
    }
    this.#gamepad(passed);
    if (now - (this.wished ?? -Infinity) >= this.apart) {
      this.wished = now;
      this.#wish();
    }
    const around = this.link.around(moment / 1000);
    if (around) this.#pose(around);
    if (this.own?.figure.visible) this.chase.to([this.own.root[0], EYE, this.own.root[2]], passed);
    if (this.loading && (this.own?.figure.visible || !this.chosen)) {
      this.loading = false;
      $("notice").hidden = true;
    }
    if (this.stage.draw()) this.#label();
    // The first picture that shows the response is being drawn now.
    if (this.answered && around && around.after.number >= this.answered.number) {
      this.responses.push(performance.now() - this.answered.at);
      if (this.responses.length > 50) this.responses.shift();
      this.answered = null;
    }
  }

  #pose({ before, after, share }) {
    const turns = new Float32Array(92);
    const places = [];
    for (const one of this.characters.values()) {
      const b = after.characters.get(one.id);
      const a = before.characters.get(one.id) ?? b;
      one.figure.visible = Boolean(b);
      if (!b) continue;
      for (let i = 0; i < 92; i += 4) Quaternion.slerpFlat(turns, i, a.rotations, i, b.rotations, i, share);
      const root = Array.from(b.root, (there, k) => CM * (a.root[k] + share * (there - a.root[k])));
      one.pose.set(one.rig, turns, 0, root, 0);
      one.figure.setPose(one.pose);
      Object.assign(one, { root, now: b });
      places.push(root[0], root[2]);
    }
    if (places.length) this.stage.shadowsAt(places);
    this.#ring();
  }

  // A ring under the user's character, with an arrow in the requested direction.
  #marker() {
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.8, depthWrite: false });
    this.ring = new Group();
    this.ring.add(new Mesh(new RingGeometry(0.36, 0.385, 48).rotateX(-Math.PI / 2), material));
    const tip = new Shape([new Vector2(-0.07, 0.42), new Vector2(0.07, 0.42), new Vector2(0, 0.56)]);
    this.arrow = new Mesh(new ShapeGeometry(tip).rotateX(Math.PI / 2), material);
    material.side = 2;
    this.ring.add(this.arrow);
    this.ring.visible = false;
    this.ring.position.y = 0.006;
    this.stage.scene.add(this.ring);
  }

  #ring() {
    this.ring.visible = Boolean(this.own?.figure.visible);
    if (!this.ring.visible) return;
    this.ring.position.x = this.own.root[0];
    this.ring.position.z = this.own.root[2];
    this.ring.children[0].material.color.set(this.own.color);
    const velocity = this.sent?.velocity;
    this.arrow.visible = Boolean(velocity && (velocity[0] || velocity[1]));
    if (this.arrow.visible) this.ring.rotation.y = Math.atan2(velocity[0], velocity[1]);
  }

  #label() {
    if (this.characters.size < 2) {
      this.labels.show([]);
      return;
    }
    const labels = [];
    for (const { id, figure, pose, color, owner } of this.characters.values()) {
      if (!figure.visible) continue;
      const top = Math.max(...pose.places.map(({ y }) => y));
      const text = owner === this.hello.client ? `${id}` : owner === null ? `${id}` : `${id} · client ${owner}`;
      labels.push({ key: `${id}/${text}`, text, name: color, x: pose.places[0].x, y: top + 0.3, z: pose.places[0].z });
    }
    this.labels.show(labels);
  }

  // ---- user input ----

  /** Sends the present wish if it differs from the last one. */
  #wish() {
    const { right, ahead, fast } = this.steering.way();
    const length = Math.hypot(right, ahead);
    const wish = { velocity: [0, 0], facing: null, type: null };
    const { camera, controls } = this.stage;
    const look = Math.atan2(controls.target.x - camera.position.x, controls.target.z - camera.position.z);
    if (length > 0) {
      this.#setMode(null);
      const speed = Math.max(SLOWEST, length * (fast ? this.speeds.running || RUN : this.speeds.walking || WALK));
      const angle = look - Math.atan2(right, ahead); // the right of the screen is -X if one faces +Z
      wish.velocity = [speed * Math.sin(angle), speed * Math.cos(angle)];
      if (this.facing) wish.facing = look;
    } else if (this.mode) Object.assign(wish, { velocity: null, type: this.mode });
    else if (this.facing) wish.facing = look;
    if (this.chosen === null || !changed(this.sent, wish, this.chosen)) return;
    // On a path, nothing is sent until the user steers.
    if (this.paths.has(this.chosen) && length === 0 && !this.mode) return;
    this.#forgetPath();
    this.sent = { ...wish, character: this.chosen };
    this.#ask("wish", { character: this.chosen, ...wish });
  }

  // Sends a request and measures the time until a picture shows the response.
  #ask(what, fields) {
    const at = this.touched ?? performance.now();
    const seq = this.link.ask(what, fields, true);
    if (seq !== null && this.touched !== null) this.waiting.push({ seq, at });
    this.touched = null;
  }

  /** Shows a type: once if it is a performance, else until requested again or until the user steers. */
  perform(name) {
    const type = this.hello.types.find((one) => one.name === name);
    if (!type || this.chosen === null) return;
    this.touched ??= performance.now();
    if (type.seconds > 0) { // a path goes on after it
      this.#setMode(null);
      this.#ask("perform", { character: this.chosen, type: name });
      return;
    }
    this.#forgetPath();
    this.#setMode(this.mode === name ? null : name);
  }

  #setMode(name) {
    if (this.mode === name) return;
    this.mode = name;
    this.typeButtons?.forEach((node, type) => node.setAttribute("aria-pressed", String(type === name)));
  }

  choose(id) {
    if (!this.mine.includes(id) || id === this.chosen) return;
    if (this.sent?.velocity?.some(Boolean)) { // keys steer the other one from now on
      this.sent = standing(this.chosen);
      this.#ask("wish", this.sent);
    }
    this.left.set(this.chosen, { sent: this.sent, mode: this.mode }); // it goes on with its dance or path
    this.#take(id);
    this.#who();
  }

  // Steers a character, which goes on with its dance or path; nothing is sent before the user steers.
  #take(id) {
    this.#forgetStroke();
    const { sent, mode } = this.left.get(id) ?? { sent: standing(id), mode: null };
    Object.assign(this, { chosen: id, sent });
    this.#setMode(mode);
  }

  /** Sends points [x, z] in metres as a path, with the indices of its stops. */
  followPath(points, stops = []) {
    if (points.length < 2 || this.chosen === null) return;
    const share = Math.max(1, (points.length - 1) / (this.hello.limits.path_points - 1));
    const kept = Array.from({ length: Math.floor((points.length - 1) / share) + 1 }, (_, n) => points[Math.round(n * share)]);
    const numbers = new Set(stops.map((at) => Math.min(kept.length - 1, Math.max(1, Math.round(at / share)))));
    this.touched ??= performance.now();
    this.watch(this.stroke);
    this.stroke = null;
    this.#ask("path", {
      character: this.chosen, points: kept.map((point) => point.map(tenths)), type: this.pathType?.value || null,
      stops: [...numbers].sort((a, b) => a - b).map((at) => [at, STOP]),
    });
  }

  /** Sends nothing until the user steers, because the character is moving already; ribbon shows its path. */
  watch(ribbon = null) {
    this.#setMode(null);
    this.#forgetPath();
    this.paths.set(this.chosen, ribbon);
    this.sent = standing(this.chosen);
  }

  // Forgets what is being drawn, which is no character's path yet.
  #forgetStroke() {
    this.#erase(this.stroke);
    this.stroke = null;
  }

  #forgetPath(id = this.chosen) {
    this.#erase(this.paths.get(id));
    this.paths.delete(id);
  }

  #erase(ribbon) {
    if (!ribbon) return;
    ribbon.removeFromParent();
    for (const { geometry } of [ribbon, ...ribbon.children]) geometry.dispose();
    this.stage.invalidate();
  }

  #mouse() {
    const canvas = $("scene");
    const ray = new Raycaster();
    const floor = new Plane(new Vector3(0, 1, 0), 0);
    const spot = (event) => {
      const box = canvas.getBoundingClientRect();
      const at = new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
      ray.setFromCamera(at, this.stage.camera);
      const hit = ray.ray.intersectPlane(floor, new Vector3());
      return hit && hit.distanceTo(this.stage.controls.target) < 60 ? [hit.x, hit.z] : null;
    };
    let [points, stops, resting, pointer] = [null, [], 0, null]; // one pointer draws
    const rest = () => {
      clearTimeout(resting);
      resting = setTimeout(() => {
        if (!points || !this.stroke) return;
        const at = points.length - 1;
        if (at < 2 || stops.includes(at)) return;
        stops.push(at);
        const mark = new Mesh(new CircleGeometry(0.11, 24).rotateX(-Math.PI / 2), new MeshBasicMaterial({ color: PATH_COLOR, depthWrite: false }));
        mark.position.set(points[at][0], 0.005, points[at][1]);
        this.stroke.add(mark);
        this.stage.invalidate();
      }, REST);
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.drawing || event.button !== 0) return;
      if (points) {
        event.stopImmediatePropagation();
        return;
      }
      const first = spot(event);
      if (!first) return;
      event.stopImmediatePropagation();
      pointer = event.pointerId;
      canvas.setPointerCapture(pointer);
      [points, stops] = [[first], []];
      this.stroke = new Ribbon(new Float32Array(first), PATH_COLOR, { width: 0.06, opacity: 0.85 });
      this.stage.scene.add(this.stroke);
    }, { capture: true });
    canvas.addEventListener("pointermove", (event) => {
      if (!points || event.pointerId !== pointer) return;
      if (!this.stroke) { // a key has ended the drawing
        points = null;
        return;
      }
      const next = spot(event);
      if (!next || Math.hypot(next[0] - points.at(-1)[0], next[1] - points.at(-1)[1]) < PATH_STEP) return;
      points.push(next);
      this.stroke.points = points.flat();
      this.stage.invalidate();
      rest();
    });
    const end = (event) => {
      if (!points || event.pointerId !== pointer) return;
      clearTimeout(resting);
      const drawn = this.stroke ? points : null;
      points = null;
      if (!drawn || event.type === "pointercancel") {
        this.#forgetStroke();
        return;
      }
      this.touched = event.timeStamp;
      if (drawn.length < 3) {
        this.#forgetStroke();
        this.say("Draw a longer path.");
      } else this.followPath(drawn, stops);
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }

  #setDrawing(on) {
    this.drawing = on;
    if (!on) this.#forgetStroke();
    if (on) this.sheets.show(null); // drawing needs the ground to be visible
    this.stage.controls.enabled = !on;
    $("scene").classList.toggle("drawing", on);
    this.pathType.parentNode.hidden = !on;
    this.#hint();
  }

  #keys() {
    let pointed = null; // a list that is opened by the pointer keeps the focus, but does not want keys
    addEventListener("pointerdown", ({ target }) => (pointed = target), { capture: true });
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || $("help").open || !this.hello) return;
      const { target } = event;
      if (target instanceof HTMLSelectElement) {
        if (target !== pointed || event.key.length > 1) {
          if (event.key === "Tab") pointed = null;
          return;
        }
        target.blur();
      }
      if ((target.type === "range" && event.key.startsWith("Arrow"))) return;
      if (this.steering.key(event, true)) {
        if (!event.repeat) this.touched = event.timeStamp;
        event.preventDefault();
        return;
      }
      if (event.repeat) return;
      const digit = /^(?:Digit|Numpad)(\d)$/.exec(event.code); // also with Shift, and on layouts where digits need it
      const key = digit ? digit[1] : event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const type = this.typeKeys.get(key);
      const action = type ? () => this.perform(type) : this.commands[key];
      // Shift+Tab always moves the focus. Tab does so too, unless several characters exist and the scene has the focus.
      const onPage = target === document.body || target === $("scene");
      if (!action || (key === "Tab" && (this.mine.length < 2 || event.shiftKey || !onPage))) return;
      if (type) this.touched = event.timeStamp;
      action();
      event.preventDefault();
    });
    addEventListener("keyup", (event) => {
      if (this.steering.key(event, false)) this.touched = event.timeStamp;
    });
    // A hidden page draws nothing, so released keys and sticks must be reported here.
    document.addEventListener("visibilitychange", () => {
      this.steering.release();
      if (this.hello) this.#wish();
    });
    addEventListener("gamepadconnected", ({ gamepad }) => {
      const known = gamepad.mapping === "standard";
      this.say(known ? `Gamepad: ${gamepad.id}` : `This browser does not know the buttons of the gamepad ${gamepad.id}.`);
    });
  }

  #gamepad(passed) {
    const [turn, lift] = this.steering.look();
    if (turn || lift) {
      const { camera, controls } = this.stage;
      const arm = camera.position.clone().sub(controls.target);
      const angle = Math.atan2(arm.x, arm.z) - 2.4 * turn * passed;
      const height = Math.max(0.02, Math.min(1.4, Math.asin(arm.y / arm.length()) + 1.2 * lift * passed));
      this.stage.look(controls.target.clone(), angle, height, arm.length());
    }
    for (const n of this.steering.newButtons()) {
      const type = [...this.typeButtons.keys()][n];
      if (n < 4 && type) this.perform(type);
      if (n === 9) this.record();
    }
  }

  // ---- controls ----

  #controls() {
    const { hello } = this;
    const shown = hello.types.filter(({ name }) => !hello.steered.includes(name));
    // Performances come first, because keys are mostly used for them.
    shown.sort((a, b) => (b.seconds > 0) - (a.seconds > 0));
    this.typeKeys = new Map();
    this.typeButtons = new Map();
    shown.forEach(({ name, seconds }, n) => {
      const keys = [];
      if (n < 10) keys.push(String((n + 1) % 10));
      if (LETTERS[name] && !this.typeKeys.has(LETTERS[name])) keys.push(LETTERS[name]);
      keys.forEach((key) => this.typeKeys.set(key, name));
      const title = seconds > 0 ? `Once, ${seconds.toFixed(1)} s` : "Until it is pressed again";
      const node = button(name, title, (event) => {
        this.touched = event.timeStamp;
        this.perform(name);
      }, name, element("span", { className: "keys" }, ...keys.map((key) => element("kbd", {}, key.toUpperCase()))));
      if (!(seconds > 0)) node.setAttribute("aria-pressed", "false");
      this.typeButtons.set(name, node);
    });
    $("types").replaceChildren(...this.typeButtons.values());
    this.#tools();
    this.#hint();
  }

  #tools() {
    const draw = toggle("Draw path", "Draw on the ground with mouse or finger, and it is followed (P)", this.drawing, (on) => this.#setDrawing(on));
    this.pathType = element("select", { title: "How to go along the path" }, new Option("on foot", ""), ...this.hello.types.map(({ name }) => new Option(name)));
    this.pathType.setAttribute("aria-label", "Type on the path");
    this.pathType.onchange = () => this.pathType.blur();
    const face = toggle("Face ahead", "Look where the camera looks, whichever way it goes (V)", this.facing, (on) => (this.facing = on));
    const info = toggle("Figures", "Measurements (I)", !$("figures").hidden, (on) => ($("figures").hidden = !on));
    this.recordButton = button("Record", `Record, and download as ${this.hello.recording_format.toUpperCase()} when it ends (O)`, () => this.record());
    const noise = element("input", { type: "range", min: "0", max: "1", step: "0.05", value: "0.05", title: "How much chance there is in the motion" });
    noise.setAttribute("aria-label", "Noise");
    noise.oninput = () => this.link.ask("noise", { character: this.chosen, kind: "correlated", temperature: Number(noise.value) });
    noise.onchange = () => noise.blur();
    this.noise = noise;
    this.bodies = element("select", { title: "Character" });
    this.bodies.setAttribute("aria-label", "Body");
    this.hello.bodies.forEach(({ name }) => this.bodies.append(new Option(name)));
    this.bodies.hidden = this.hello.bodies.length < 2;
    this.bodies.onchange = () => {
      this.link.ask("body", { character: this.chosen, body: this.bodies.value });
      this.bodies.blur();
    };
    const theme = () => this.stage.flipTheme();
    this.commands = {
      p: draw.flip, v: face.flip, i: info.flip, o: () => this.record(), t: theme, Tab: () => this.#next(), n: () => this.add(),
      Escape: () => this.drawing && draw.flip(), "?": () => $("help").showModal(), Backspace: () => this.#restart(),
    };
    $("tools").replaceChildren(
      this.bodies, element("label", {}, "Noise", noise), draw.node, element("label", { hidden: !this.drawing }, "Path", this.pathType), face.node, this.recordButton, ...this.tools(this), info.node,
      button("Start anew", "Back to where it first stood (Backspace)", () => this.#restart(), "⟲"),
      button("Theme", "Dark or light (T)", theme, "◐"),
      button("Help", "Keyboard (?)", () => $("help").showModal(), "?"),
    );
    fillHelp($("help"), "Steering", [
      [["W", "A", "S", "D"], "go, as the camera sees it; arrows too"],
      [["Shift"], "faster"],
      [["1", "…", "0"], "the types below; some have letters too"],
      [["P"], "draw a path with the mouse"],
      [["V"], "face ahead: go backwards and aside"],
      [["O"], "record; again to end and download"],
      [["N"], "another character"],
      [["Tab"], "steer the next of one's characters; with Shift to the buttons"],
      [["Backspace"], "start anew"],
      [["T", "I"], "theme; measurements"],
      [["Touch"], "the stick goes, past its rim fast; drag looks around, two fingers come nearer"],
      [["Pad"], "left stick or cross goes, a right trigger faster, right stick looks, A B X Y show the first types, menu records"],
    ]);
  }

  #who() {
    if (!this.mine) return;
    const nodes = this.mine.map((id, n) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = COLORS[n % COLORS.length];
      const box = element("div", { className: "character" }, button(`Character ${id}`, "Steer this one (Tab)", () => this.choose(id), swatch, `${id}`));
      box.classList.toggle("chosen", id === this.chosen);
      if (this.mine.length > 1) {
        const close = button(`Remove character ${id}`, "Remove", () => this.#dismiss(id), "×");
        close.classList.add("close");
        box.append(close);
      }
      return box;
    });
    const others = this.facts.size - this.mine.length;
    const key = JSON.stringify([this.mine, this.chosen, others]);
    if (key !== this.listed) { // a list that is replaced loses the click that is being made on it
      this.listed = key;
      $("who").replaceChildren(...nodes, button("Add a character", "Another character (N)", () => this.add(), "+"));
      if (others) $("who").append(element("label", {}, `${others} of others`));
    }
    const own = this.facts.get(this.chosen);
    if (own) {
      this.bodies.value = own.body;
      if (document.activeElement !== this.noise) this.noise.value = String(own.temperature);
      this.#recordState(this.chosen, own.recording);
    }
  }

  /** Offers one more body, and puts it on a character. */
  offer(name, character = this.chosen) {
    if (!this.hello.bodies.some((body) => body.name === name)) this.hello.bodies.push({ name });
    this.rigs.delete(name);
    this.#tools();
    this.#who();
    this.link.ask("body", { character, body: name });
  }

  add() {
    this.link.ask("add", { body: this.facts.get(this.chosen)?.body ?? "default" });
  }

  // Downloads the character's recording first.
  #dismiss(character) {
    if (this.facts.get(character)?.recording) this.link.ask("record", { character, on: false });
    this.link.ask("remove", { character });
  }

  #next() {
    if (this.mine.length) this.choose(this.mine[(this.mine.indexOf(this.chosen) + 1) % this.mine.length]);
  }

  #restart() {
    this.#forgetAll();
    this.link.ask("reset", { character: this.chosen });
  }

  // Forgets what the steered character was asked for; a held key is sent again.
  #forgetAll() {
    this.#forgetPath();
    this.#forgetStroke();
    this.#setMode(null);
    this.sent = null;
  }

  /** Starts or ends a recording. */
  record() {
    if (this.chosen === null) return;
    this.link.ask("record", { character: this.chosen, on: !this.facts.get(this.chosen)?.recording });
  }

  #recordState(character, on) {
    const from = on ? (this.recordedFroms.get(character) ?? performance.now()) : null;
    if (on) this.recordedFroms.set(character, from);
    else this.recordedFroms.delete(character);
    if (from === this.recordedFrom && this.recordButton.querySelector(".dot")) return;
    this.recordedFrom = from;
    this.recordButton.classList.toggle("recording", on);
    this.recordButton.replaceChildren(element("span", { className: "dot" }), on ? "0.0 s" : "Record");
  }

  // Downloads a recording; others maps endings to functions that make its address in that format.
  #save({ character, url, format, seconds, others = {} }) {
    const name = (ending) => `motionkit-recording.${ending}`;
    const link = element("a", { href: url, download: name(format) }, `${format.toUpperCase()} again`);
    const more = Object.entries(others).flatMap(([ending, make]) => {
      const other = element("a", { href: "#", download: name(ending) }, `as ${ending.toUpperCase()}`);
      other.onclick = async (event) => {
        if (other.href.startsWith("blob:")) return;
        event.preventDefault();
        const shown = [this.characters.get(character), ...this.characters.values()].find((one) => one?.figure.mesh);
        if (!shown) return void (other.textContent = `as ${ending.toUpperCase()}: first show a character in a body of motionkit`);
        other.href = await make(shown.figure);
        other.click();
      };
      return [", ", other];
    });
    link.click();
    this.say(`Recorded ${seconds.toFixed(1)} s: `, link, ...more);
  }

  /** Shows a line to the user for a while. */
  say(...parts) {
    clearTimeout(this.forgetting);
    $("hint").replaceChildren(...parts);
    $("hint").style.pointerEvents = "auto";
    $("hint").dataset.said = "true";
    this.forgetting = setTimeout(() => this.#hint(), 12_000);
  }

  #hint() {
    const touch = matchMedia("(pointer: coarse)").matches;
    const text = this.drawing
      ? `Draw on the ground with mouse or finger; rest a moment where the path is to stop. ${touch ? "More, then" : "Esc or"} Draw path ends drawing.`
      : touch
        ? "Push the stick to go, past its rim to run; drag elsewhere to look around"
        : "W A S D to go, Shift faster, drag to look around, ? for all keys";
    $("hint").style.pointerEvents = "none";
    delete $("hint").dataset.said;
    $("hint").replaceChildren(text);
  }

  #pace() {
    $("pace").hidden = !this.behind;
    if (this.behind) {
      $("pace").textContent = `This machine falls behind: ${this.behind.fps.toFixed(0)} of ${this.hello.fps} frames a second. Motion is slower than real time; nothing is left out.`;
    }
  }

  #measures() {
    if (!this.newest) return;
    const now = performance.now();
    const passed = (now - (this.measured?.at ?? now)) / 1000;
    const drawn = passed > 0 ? (this.stage.frames - this.measured.frames) / passed : 0;
    this.measured = { at: now, frames: this.stage.frames };
    this.smoothed = this.smoothed ? 0.7 * this.smoothed + 0.3 * drawn : drawn;
    const { newest, link, responses, hello } = this;
    if (this.behind) {
      this.behind.fps = newest.fps; // the event's own rate is soon out of date
      this.#pace();
    }
    const middle = [...responses].sort((a, b) => a - b)[Math.floor(responses.length / 2)];
    const rows = [
      ["step", `${newest.stepMs.toFixed(1)} ms`, newest.stepMs > 1000 / hello.fps],
      ["frames made", `${newest.fps.toFixed(0)} /s`, newest.fps < 0.95 * hello.fps],
      ["frames drawn", `${this.smoothed.toFixed(0)} /s`],
      ...(link.delay === undefined ? [] : [["network", `${link.delay.toFixed(1)} ms`]]),
      ["response", middle === undefined ? "–" : `${responses.at(-1).toFixed(0)} ms, median ${middle.toFixed(0)}`],
    ];
    $("figures").replaceChildren(...rows.flatMap(([name, text, bad]) => [element("span", {}, name), element("b", { className: bad ? "bad" : "" }, text)]));
    if (this.recordedFrom) this.recordButton.lastChild.textContent = `${((now - this.recordedFrom) / 1000).toFixed(1)} s`;
    const type = this.own?.now && hello.types[this.own.now.type]?.name;
    this.typeButtons.forEach((node, name) => node.classList.toggle("shown", name === type && this.own.now.performing));
  }
}

// Metres as tenths of centimetres, because a message may have so many bytes.
const tenths = (metres) => Math.round((10 * metres) / CM) / 10;

// Whether a wish differs from the last one sent.
function changed(sent, wish, character) {
  if (!sent || sent.character !== character || sent.type !== wish.type) return true;
  if ((sent.facing === null) !== (wish.facing === null) || (sent.velocity === null) !== (wish.velocity === null)) return true;
  if (wish.facing !== null && Math.abs(Math.atan2(Math.sin(wish.facing - sent.facing), Math.cos(wish.facing - sent.facing))) > TURNED) return true;
  if (wish.velocity === null) return false;
  const size = Math.hypot(...wish.velocity);
  return Math.hypot(wish.velocity[0] - sent.velocity[0], wish.velocity[1] - sent.velocity[1]) > (size > 0 ? TURNED * size : 0);
}

/** Makes the page and exposes it for tests; on failure shows the reason and returns null. */
export function open(make) {
  try {
    return (window.motionkit = make());
  } catch (error) {
    refused("page", error);
    return null;
  }
}
