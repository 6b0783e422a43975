/** The page receives and draws the published states, also with many tabs. Only counts are asserted;
 * times depend on the load of the machine and are diagnostics. */
import assert from "node:assert/strict";
import { connect, type Socket } from "node:net";
import { loadavg } from "node:os";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";

/** States published one by one, each after the page has received the previous one: none may be lost. */
const SINGLE = 20;
/** The number of states that are published during a run. */
const RUN = 300;
/** The steps per published state in the test of fifty WebSockets. */
const EVERY = 2;
/** The share of the run's states that the page of a thousand bodies must receive and draw. A slow page
 * receives the newest (docs/page.md), so the share depends on the load: this is six states a second. */
const MIN_SHARE = 0.25;
/** The longer run takes 12 s on an idle machine. */
const RUN_TIMEOUT_MS = 120_000;
/** The distance in pixels between a body and its expected position; a step moves most bodies further. */
const TOLERANCE_PX = 0.01;

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

interface Status {
  step: number;
  phase: string;
  result: { real_time_factor: number | null };
}

interface StateJson {
  step: number;
  x: number[];
  y: number[];
}

const status = (swarm: string) => daemon.get<Status>(`${swarm}/get/status`);

/** Runs a swarm up to a step, and returns the greatest real-time factor on the way. */
async function runUntil(swarm: string, step: number): Promise<number> {
  let factor = 0;
  await daemon.command(swarm, "run", { until_step: step });
  const ended = async () => {
    const now = await status(swarm);
    factor = Math.max(factor, now.result.real_time_factor ?? 0);
    return now.phase === "paused" && now.step === step;
  };
  await until(`step ${step}`, ended, RUN_TIMEOUT_MS);
  return factor;
}

/** The steps of the states that a page has received and drawn. */
interface Seen {
  received: number[];
  /** The newest state received before each frame, which that frame must draw. */
  due: number[];
  drawn: number[];
  frames: number;
  pictures: number;
}

/** Runs in the page before its scripts: reads the step of a state from its CBOR, the text "step" and an
 * unsigned integer. */
function defineStepOf(): void {
  const stepOf = (data: ArrayBuffer) => {
    const at = new TextDecoder("latin1").decode(data.slice(0, 256)).indexOf("dstep") + 5;
    const view = new DataView(data);
    const head = view.getUint8(at);
    const long = { 24: () => view.getUint8(at + 1), 25: () => view.getUint16(at + 1) }[head];
    return long ? long() : head;
  };
  Object.assign(globalThis, { stepOf });
}

declare function stepOf(data: ArrayBuffer): number;

/** Runs in the page before its scripts: records the states that its WebSocket receives, and the step
 * in the numbers panel when a picture is drawn. */
function recordStates(): void {
  const seen: Seen = { received: [], due: [], drawn: [], frames: 0, pictures: 0 };
  Object.assign(globalThis, { seen });
  const keep = (steps: number[], step: number) => {
    if (steps.at(-1) !== step) {
      steps.push(step);
    }
  };
  const Socket = globalThis.WebSocket;
  globalThis.WebSocket = class extends Socket {
    constructor(address: string | URL, protocols?: string | string[]) {
      super(address, protocols);
      this.addEventListener("message", ({ data }) => {
        if (typeof data !== "string") {
          keep(seen.received, stepOf(data));
        }
      });
    }
  };
  const { fillRect } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillRect = function (x, y, width, height) {
    if (this.canvas.className === "picture" && x === 0 && y === 0) {
      seen.pictures += 1;
      keep(seen.drawn, Number(document.querySelector('dd[data-number="step"]')?.textContent));
    }
    fillRect.call(this, x, y, width, height);
  };
  const frame = () => {
    seen.frames += 1;
    const newest = seen.received.at(-1);
    if (newest !== undefined) {
      keep(seen.due, newest);
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

/** Runs in the page: records the positions of the bodies in the last picture, where so many bodies
 * are drawn as polygons. */
function recordPlaces(): void {
  const prototype = CanvasRenderingContext2D.prototype;
  const { beginPath, moveTo, lineTo, fill, fillRect } = prototype;
  let path: number[] = [];
  let places: [number, number][] = [];
  Object.assign(prototype, {
    beginPath(this: CanvasRenderingContext2D) {
      path = [];
      beginPath.call(this);
    },
    moveTo(this: CanvasRenderingContext2D, x: number, y: number) {
      path.push(x, y);
      moveTo.call(this, x, y);
    },
    lineTo(this: CanvasRenderingContext2D, x: number, y: number) {
      path.push(x, y);
      lineTo.call(this, x, y);
    },
    fill(this: CanvasRenderingContext2D) {
      (fill as () => void).call(this);
      // The first and the sixth of the ten corners are opposite.
      if (this.canvas.className === "picture" && path.length === 20) {
        places.push([(path[0]! + path[10]!) / 2, (path[1]! + path[11]!) / 2]);
      }
    },
    fillRect(this: CanvasRenderingContext2D, x: number, y: number, w: number, h: number) {
      if (this.canvas.className === "picture" && x === 0 && y === 0) {
        places = [];
        Object.assign(globalThis, { places });
      }
      fillRect.call(this, x, y, w, h);
    },
  });
}

/** Whether the last picture shows a state: each drawn body is at its position. */
async function shows(page: Page, { x, y }: StateJson): Promise<boolean> {
  const [places, scale, width, height] = await page.evaluate<
    [[number, number][], number, number, number]
  >(`(() => {
    const canvas = document.querySelector("canvas.picture");
    return [places, Number(canvas.dataset.scale), canvas.clientWidth, canvas.clientHeight];
  })()`);
  const mean = (column: number[]) => column.reduce((sum, it) => sum + it, 0) / column.length;
  const [mx, my] = [mean(x), mean(y)];
  let next = 0;
  // Bodies are drawn in order of their index, without invisible ones.
  x.forEach((_, i) => {
    const place = places[next];
    const left = width / 2 + (x[i]! - mx) * scale;
    const top = height / 2 - (y[i]! - my) * scale;
    if (place && Math.hypot(place[0] - left, place[1] - top) < TOLERANCE_PX) {
      next += 1;
    }
  });
  return next === places.length && next > 0.9 * x.length;
}

test("with 1000 bodies and no GPU each frame draws the newest state, and no single step is lost", async (t) => {
  await daemon.create("thousand", { n: 1000, seed: 1, rate: 0.5, publish_every: 1 });
  const { page } = await openTab();
  await page.addInitScript(defineStepOf);
  await page.addInitScript(recordStates);
  await page.goto(`${daemon.addresses.http}/#/swarm/thousand`);
  const seen = () => page.evaluate<Seen>("seen");
  await until("a picture", async () => (await seen()).drawn.at(-1) === 0);

  const [before, began] = [await seen(), Date.now()];
  const factor = await runUntil("thousand", RUN);
  await until("the last state", async () => (await seen()).received.at(-1) === RUN);
  const { frames } = await seen();
  await until("the frames after it", async () => (await seen()).frames > frames + 2);
  const [all, secs] = [await seen(), (Date.now() - began) / 1000];
  const count = (steps: number[]) => new Set(steps.filter((it) => 0 < it && it <= RUN)).size;
  const [received, drawn] = [count(all.received), count(all.drawn)];
  t.diagnostic(
    `of ${RUN} states ${received} received, ${drawn} drawn; real-time factor ${factor.toFixed(2)}`,
  );
  const rate = (now: number, then: number) => ((now - then) / secs).toFixed(1);
  t.diagnostic(
    `${rate(all.pictures, before.pictures)} pictures and ${rate(all.frames, before.frames)} frames ` +
      `a second; load ${loadavg()[0]?.toFixed(1)}`,
  );
  // At any load a frame draws the newest state received before it.
  const left_out = all.due.filter((it) => !all.drawn.includes(it));
  assert.deepEqual(left_out, [], "states that were the newest and were not drawn");
  assert.equal(all.drawn.at(-1), RUN, "the last state is drawn");
  assert(received >= MIN_SHARE * RUN, `${received} of ${RUN} states received`);
  assert(drawn >= MIN_SHARE * RUN, `${drawn} of ${RUN} states drawn`);

  await page.evaluate(recordPlaces);
  for (let step = RUN + 1; step <= RUN + SINGLE; step += 1) {
    await daemon.command("thousand", "step");
    const state = await daemon.get<StateJson>("thousand/state?format=json");
    assert.equal(state.step, step);
    await until(`the numbers of state ${step}`, async () => (await seen()).drawn.at(-1) === step);
    await until(`the picture of state ${step}`, () => shows(page, state));
  }
  await daemon.command("thousand", "delete");
});

test("fifty WebSockets receive each single step and the end of a run, and one that is not read blocks no other", async (t) => {
  await daemon.create("crowd", { n: 50, seed: 1, rate: 2, publish_every: EVERY });
  const suspended = await unread("crowd");
  const { page } = await openTab();
  await page.addInitScript(defineStepOf);
  await page.goto(`${daemon.addresses.http}/#/`);
  await page.evaluate(openSockets, 50);
  const sockets = () => page.evaluate<number[][]>("sockets");
  const all = (step: number) =>
    until(`state ${step} in each tab`, async () =>
      (await sockets()).every((steps) => steps.at(-1) === step),
    );
  await all(0);

  // During a run a slow socket may miss states, but it receives the last one.
  const last = RUN * EVERY;
  const factor = await runUntil("crowd", last);
  await all(last);
  const counts = (await sockets()).map((steps) => steps.length - 1);
  const least = Math.min(...counts);
  t.diagnostic(
    `of ${RUN} states ${least} to ${Math.max(...counts)}; real-time factor ${factor.toFixed(2)}; ` +
      `load ${loadavg()[0]?.toFixed(1)}`,
  );

  for (let step = last + 1; step <= last + SINGLE; step += 1) {
    await daemon.command("crowd", "step");
    await all(step);
  }
  for (const steps of await sockets()) {
    const sorted = [...steps].sort((a, b) => a - b);
    assert.deepEqual(steps, sorted, "no state after a newer one");
  }
  assert.equal(suspended.bytesRead, 0);
  suspended.destroy();
  await daemon.command("crowd", "delete");
});

/** Runs in the page: opens WebSockets like `count` tabs, and records the step of each state. */
function openSockets(count: number): void {
  const sockets = Array.from({ length: count }, (): number[] => []);
  Object.assign(globalThis, { sockets });
  for (const steps of sockets) {
    const socket = new WebSocket(`ws://${location.host}/api/ws?swarm=crowd`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string" && steps.at(-1) !== stepOf(data)) {
        steps.push(stepOf(data));
      }
    };
  }
}

/** Opens a WebSocket and does not read from it, like a suspended tab. */
async function unread(swarm: string): Promise<Socket> {
  const { hostname, port } = new URL(daemon.addresses.http);
  const socket = connect(Number(port), hostname);
  socket.pause();
  await new Promise((resolve) => socket.once("connect", resolve));
  const lines = [
    `GET /api/ws?swarm=${swarm} HTTP/1.1`,
    `Host: ${hostname}:${port}`,
    "Connection: Upgrade",
    "Upgrade: websocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
  ];
  socket.write(`${lines.join("\r\n")}\r\n\r\n`);
  return socket;
}
