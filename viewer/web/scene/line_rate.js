/** Approximate time in milliseconds over which the data rate is averaged. Only the time of running requests counts. */
const WINDOW_MS = 2000;

/** Measures the data rate of a connection while requests are running. */
export class LineRate {
  /** @param {() => number} [now] A clock in milliseconds. */
  constructor(now = () => performance.now()) {
    this.now = now;
    this.running = 0;
    this.bytes = 0;
    this.ms = 0;
    this.last = 0;
  }

  /** Reports the start of a request. */
  begin() {
    this.#pass();
    this.running++;
  }

  /**
   * Reports received data.
   * @param {number} count In bytes.
   */
  receive(count) {
    this.bytes += count;
    this.#pass();
  }

  /** Reports the end of a request. */
  end() {
    this.#pass();
    this.running--;
  }

  /** The data rate, or null if nothing has been received yet. */
  get bytesPerSecond() {
    this.#pass();
    return this.bytes > 0 && this.ms > 0 ? (1000 * this.bytes) / this.ms : null;
  }

  #pass() {
    const now = this.now();
    if (this.running > 0) this.ms += now - this.last;
    this.last = now;
    if (this.ms <= WINDOW_MS) return;
    this.bytes *= WINDOW_MS / this.ms;
    this.ms = WINDOW_MS;
  }
}
