// Everything a page needs to show and steer a figure, in one module.

export { Chase } from "./chase.js";
export { Clip } from "./clip.js";
export { Figure } from "./figure.js";
export { Labels } from "./labels.js";
export { Footprints, Ribbon } from "./marks.js";
export { Pose, Rig } from "./rig.js";
export { Sheets } from "./sheet.js";
export { Stage } from "./stage.js";
export { Steering } from "./steering.js";
export { ThumbStick } from "./stick.js";
