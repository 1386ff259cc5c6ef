// The page of `motionkit play`, connected to the server it comes from.

import { Link } from "./link.js";
import { Play, open } from "./play.js";

const scheme = location.protocol === "https:" ? "wss" : "ws";
if (open(() => new Play((listeners) => new Link(`${scheme}://${location.host}/live`, listeners)))) {
  document.documentElement.dataset.ready = "true";
}
