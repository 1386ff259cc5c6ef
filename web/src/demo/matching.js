// Finds the frames of reference clips that are most like a pose and a trajectory: Python's MotionIndex
// (control/motion_index.py).

const NEARBY = 90; // frames
const [POSITION_UNIT, DIRECTION_UNIT, HALF] = [20, 0.5, 12];

export class MotionIndex {
  /**
   * @param {object[]} clips of a type
   * @param {(clip: object, at: number) => Float32Array} state the pose of a frame and those before it
   * @param {(clip: object, at: number) => Float32Array} trajectory where the recording went after a frame
   */
  constructor(clips, state, trajectory) {
    this.frames = clips.flatMap((clip) => {
      const moves = new Uint8Array(clip.frames);
      clip.moves.forEach(([from, to]) => moves.fill(1, from, to));
      return Array.from({ length: clip.frames }, (_, at) => ({ clip, at, moves: moves[at], state: state(clip, at), trajectory: scaled(trajectory(clip, at)) }));
    });
    this.first = new Map();
    this.frames.forEach(({ clip }, n) => this.first.has(clip) || this.first.set(clip, n));
  }

  /**
   * The clip and the frame most like a state and a trajectory.
   * @param {number} least frames that must follow in the clip
   * @param {[object, number] | null} stay the present clip and frame, kept unless one far enough from it costs less than gain times as much
   */
  nearest(state, trajectory, least, stay = null, gain = 1) {
    const wanted = scaled(trajectory);
    const cost = (frame) => squared(frame.state, state) + squared(frame.trajectory, wanted);
    const here = stay && this.first.get(stay[0]) + stay[1];
    let [best, lowest] = [this.frames[0], Infinity];
    this.frames.forEach((frame, n) => {
      if (!frame.moves || frame.clip.frames - frame.at < least) return;
      if (stay && n >= here - NEARBY && n < here + NEARBY) return;
      const found = cost(frame);
      if (found < lowest) [best, lowest] = [frame, found];
    });
    return stay && lowest >= gain * cost(this.frames[here]) ? stay : [best.clip, best.at];
  }
}

const scaled = (trajectory) => trajectory.map((value, n) => value / (n < HALF ? POSITION_UNIT : DIRECTION_UNIT));

/** The sum of squared differences. */
export function squared(a, b) {
  let sum = 0;
  for (let n = 0; n < a.length; n++) sum += (a[n] - b[n]) ** 2;
  return sum;
}
