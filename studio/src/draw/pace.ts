/**
 * When to draw, and how finely: at most one drawing is under way; their times set the resolution of the next ones.
 *
 * Software rendering is bound by the number of pixels, so a quarter of them takes about a quarter of the time. What is
 * at rest is drawn with all pixels, however long that takes.
 */

const AIM = 55; // milliseconds for a drawing while things move
const REMEMBERED = 5; // drawings: one that the machine was too busy for says nothing
const REST = 350; // milliseconds without a change
const GIVEN_UP = 5000; // milliseconds after which a drawing counts as finished: its end may never be told
const HELD_BACK = 500; // milliseconds
const SCALES = [0.25, 0.35, 0.5, 0.7, 1];

export class Pace {
  private wanted = false;
  private resting = 0;
  private scale = 0.5;
  private readonly costs: number[] = []; // milliseconds at scale 1, of the newest drawings
  private underWay = 0;
  private begun = 0;
  private newest = 0;
  private sharp = false;

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

  /** Something changed. */
  request(): void {
    this.wanted = true;
    this.resting = performance.now() + REST;
    this.sharp = false;
  }

  /** The scale of drawings while things move. */
  get current(): number {
    return this.scale;
  }

  /** The scale of the newest drawing. */
  get drawn(): number {
    return this.newest;
  }

  /** Whether the newest change is drawn, as finely as it will be. */
  get rests(): boolean {
    return this.sharp && this.underWay === 0;
  }

  private turn(): void {
    if (this.underWay > 0) {
      const passed = performance.now() - this.begun;
      const took = this.finished() ?? (passed > GIVEN_UP ? passed : null);
      if (took === null) return;
      this.learn(took, this.underWay);
      this.underWay = 0;
    }
    if (this.wanted) {
      this.wanted = false;
      this.start(this.scale);
    } else if (!this.sharp && performance.now() > this.resting) {
      this.sharp = true;
      if (this.newest < 1) this.start(1);
    }
  }

  private start(scale: number): void {
    this.underWay = this.newest = scale;
    this.begun = performance.now();
    this.draw(scale);
  }

  private learn(took: number, scale: number): void {
    this.costs.push(took / scale ** 2);
    if (this.costs.length > REMEMBERED) this.costs.shift();
    const usual = [...this.costs].sort((a, b) => a - b)[Math.floor(this.costs.length / 2)];
    this.scale = [...SCALES].reverse().find((one) => usual * one ** 2 < AIM) ?? SCALES[0];
  }
}
