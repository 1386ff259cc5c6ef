// The page of `motionkit demo`: the live page with the model inside, without a server.

import { button, element } from "../lib/dom.js";
import { heroBody } from "./hero.js";
import { Play, open } from "../play/play.js";
import { Kernel } from "./kernel.js";
import { LocalLink } from "./link.js";
import { readModel } from "./model.js";
import { addressOf, readAddress } from "./share.js";
import { MOST } from "./world.js";

document.getElementById("figures").hidden = true;
const notice = document.getElementById("notice");
const still = matchMedia("(prefers-reduced-motion: reduce)");

// Loading starts first, because it takes longest.
const loaded = Promise.all([fetched("motionkit.wasm").then((bytes) => WebAssembly.compile(bytes)), fetched("model.bin", telling).then(readModel)]);
let damaged = false;
const replayed = readAddress(location.href).catch(() => ((damaged = true), null));
addEventListener("hashchange", () => location.reload()); // another link, opened in the same tab

async function fetched(name, report = () => {}) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`${name} is missing (${answer.status})`);
  let got = 0;
  const counted = new TransformStream({ transform: (chunk, out) => [report((got += chunk.length)), out.enqueue(chunk)] });
  return new Response(answer.body.pipeThrough(counted)).arrayBuffer();
}

function telling(bytes) {
  notice.textContent = `Loading the model: ${(bytes / 1e6).toFixed(1)} MB …`;
}

function tools(play) {
  const share = button("Copy link", "A link that does all of this again", async () => {
    const { seed, done } = play.link.world;
    const address = await addressOf(seed, done);
    if (!address) play.say("So much was asked for that it does not fit into a link. Load the page anew and begin again.");
    else {
      history.replaceState(null, "", address);
      const link = element("a", { href: address, onclick: () => location.reload() }, "Link"); // it is the page's own address
      const copied = navigator.clipboard?.writeText(address) ?? Promise.reject(); // browsers copy on safe pages only
      await copied.then(() => play.say(link, " copied: it does all of this again."), () => play.say(link, ": it does all of this again. It is in the address bar too."));
    }
  });
  const choice = element("input", { type: "file", accept: ".glb,.vrm", hidden: true, ariaLabel: "File of your character", onchange: () => choice.files[0] && wear(play, choice.files[0]) });
  return [button("Your character", "A .glb or .vrm file of yours moves instead; nothing is sent anywhere", () => {
    choice.value = ""; // else the same file, mended, is no change
    choice.click();
  }), choice, share];
}

/** Puts a user's file on the steered character, or says what is wrong with it. */
async function wear(play, file) {
  const { link, chosen } = play;
  if (play.facts.get(chosen)?.recording) {
    play.say(`End the recording, then give ${file.name} again: a recording is of one body.`);
    return;
  }
  try {
    play.say(`Reading ${file.name} …`);
    const body = await heroBody(file, link.bodies.default, rigs);
    const [, stem, ending] = /^(.*?)(\.vrm|\.glb)?$/i.exec(file.name);
    let name = `${stem}${ending ?? ".glb"}`;
    for (let n = 2; link.bodies[name]; n++) name = `${stem} ${n}${ending ?? ".glb"}`;
    link.bodies[name] = body;
    play.offer(name, chosen);
    play.say(`${file.name} stays on this machine. Record gives it back with the motion in it.`);
  } catch (error) {
    play.say(`${file.name}: ${error.message}.`);
  }
}

addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file) begun?.then(() => wear(window.motionkit, file), () => {}); // a failure is shown already
});

async function begin(play) {
  const [module, model] = await loaded;
  const kernel = await Kernel.from(module, model, MOST);
  const old = await replayed;
  const first = old?.done ?? (still.matches ? [] : [[0, { do: "stroll", character: 1 }]]);
  play.link.begin(kernel, old?.seed ?? 1 + Math.floor(Math.random() * 9999), first);
  if (first.length) play.watch();
  if (damaged) play.say("The link is cut off or damaged, so this is another motion.");
  document.documentElement.dataset.ready = "true";
  try { // without it the page works, but not offline
    await navigator.serviceWorker?.register("sw.js");
  } catch {
    // Some browsers throw where storage is blocked.
  }
}

let begun = null; // the session, once the model is there
const { bodies, first, rigs } = JSON.parse(document.getElementById("data").textContent);
if (open(() => new Play((listeners) => new LocalLink(listeners, bodies), tools))) {
  window.motionkit.stand("default", first);
  begun = begin(window.motionkit);
  begun.catch((error) => {
    Object.assign(notice, { hidden: false, className: "notice" });
    notice.textContent = location.protocol === "file:" ? "Browsers load models from servers only: run `python -m http.server` in this folder, and open the address it says." : `The model cannot be loaded: ${error.message}.`;
  });
}
