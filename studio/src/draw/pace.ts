/**
 * When to draw, and how finely: at most one drawing is under way; their times set the resolution of the next ones.
 *
 * What rests is drawn with all pixels, however long that takes. While things move, the resolution falls as far as it
 * must. What a drawing costs for itself and for its pixels depends on the machine, so nothing is extrapolated: a scale is
 * left when a drawing at it is too slow, and the next finer one is tried again when there is time to spare.
 */

const AIM = 60; // milliseconds for a drawing while things move
const SPARE = 0.7; // of them: a finer scale is tried below
const PATIENCE = 3; // drawings in a row that are too slow: one alone says that the machine was busy
const FORGOTTEN = 4000; // milliseconds after which a scale that was too slow is tried again
const REST = 350; // milliseconds without a movement
const GIVEN_UP = 5000; // milliseconds after which a drawing counts as finished: its end may never be told
const HELD_BACK = 500; // milliseconds
const SCALES = [0.25, 0.35, 0.5, 0.7, 1];

/** The scale of drawings while things move, learnt from how long they took. */
export class Scale {
  private at = SCALES.length - 1;
  private slow = 0; // drawings in a row
  private left = -Infinity; // when a finer scale was too slow

  get current(): number {
    return SCALES[this.at];
  }

  /** A drawing at a scale took so many milliseconds; `now` in milliseconds, too. */
  learn(took: number, scale: number, now: number): void {
    if (scale !== this.current) return;
    this.slow = took > AIM ? this.slow + 1 : 0;
    if (this.slow >= PATIENCE && this.at > 0) [this.at, this.slow, this.left] = [this.at - 1, 0, now];
    else if (took < SPARE * AIM && this.at < SCALES.length - 1 && now - this.left > FORGOTTEN) this.at++;
  }
}

export class Pace {
  private wanted = false;
  private movesUntil = 0;
  private readonly scale = new Scale();
  private underWay = 0;
  private begun = 0;
  private newest = 0;

  /**
   * @param draw draws at a scale (1: all pixels of the screen)
   * @param finished milliseconds that the last drawing took, null while it is under way
   */
  constructor(private readonly draw: (scale: number) => void, private readonly finished: () => number | null) {
    const turn = () => {
      requestAnimationFrame(turn);
      this.turn();
    };
    requestAnimationFrame(turn);
    // A browser may hold animation frames back for as long as it is busy; what is new is drawn all the same.
    setInterval(() => !document.hidden && this.turn(), HELD_BACK);
  }

  /** Something changed; `moves`: the camera or the look did. */
  request(moves: boolean): void {
    this.wanted = true;
    if (moves) this.movesUntil = performance.now() + REST;
  }

  /** The scale of drawings while things move. */
  get current(): number {
    return this.scale.current;
  }

  /** The scale of the newest drawing. */
  get drawn(): number {
    return this.newest;
  }

  /** Whether the newest change is drawn, as finely as it will be. */
  get rests(): boolean {
    return !this.wanted && this.newest === 1 && this.underWay === 0;
  }

  private turn(): void {
    const now = performance.now();
    if (this.underWay > 0) {
      const passed = now - this.begun;
      const took = this.finished() ?? (passed > GIVEN_UP ? passed : null);
      if (took === null) return;
      this.scale.learn(took, this.underWay, now);
      this.underWay = 0;
    }
    const moves = now < this.movesUntil;
    if (!this.wanted && (moves || this.newest === 1)) return;
    this.wanted = false;
    this.underWay = this.newest = moves ? this.scale.current : 1;
    this.begun = now;
    this.draw(this.underWay);
  }
}
