/** How fast the page draws, and what many tabs cost. */
import assert from "node:assert/strict";
import { connect, type Socket } from "node:net";
import { loadavg } from "node:os";
import { after, before, test } from "node:test";
import type { Browser } from "playwright-core";
import { launch, openTab, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";

/** For how long a thousand bodies are looked at. */
const SECONDS = 30;
/** Of the states published this part reaches the page at least, and of those this part is drawn. */
const RECEIVED = 0.98;
const DRAWN = 0.95;
/** Pictures for each state, of 25 a second: motion is drawn between them. */
const PICTURES = 1.6;

let browser: Browser;
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
  browser = await launch();
});

after(async () => {
  await browser.close();
  await daemon.end();
});

interface Status {
  result: { step: number; phase: string; real_time_factor: number | null };
}

const status = async (swarm: string) => (await daemon.get<Status>(`${swarm}/get/status`)).result;

/** What a page has received and drawn so far. */
interface Count {
  received: number;
  drawn: number;
  pictures: number;
}

/** Runs in the page: counts states that its socket brings, states whose numbers are shown, which are
 * those that are drawn, and pictures, each of which begins with the canvas filled. */
function countStates(): void {
  const count: Count = { received: 0, drawn: 0, pictures: 0 };
  Object.assign(globalThis, { count });
  const Socket = globalThis.WebSocket;
  globalThis.WebSocket = class extends Socket {
    constructor(address: string | URL, protocols?: string | string[]) {
      super(address, protocols);
      this.addEventListener("message", ({ data }) => {
        count.received += typeof data === "string" ? 0 : 1;
      });
    }
  };
  const { fillRect } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillRect = function (x, y, width, height) {
    count.pictures += this.canvas.className === "picture" && x === 0 && y === 0 ? 1 : 0;
    fillRect.call(this, x, y, width, height);
  };
  let last: string | null = null;
  const look = () => {
    const step = document.querySelector('dd[data-number="step"]')?.textContent ?? null;
    count.drawn += step !== last ? 1 : 0;
    last = step;
  };
  addEventListener("DOMContentLoaded", () => {
    new MutationObserver(look).observe(document.body, {
      characterData: true,
      childList: true,
      subtree: true,
    });
  });
}

test("of a thousand bodies every state is drawn, and motion between them, without a GPU", async (t) => {
  await daemon.create("thousand", { n: 1000, seed: 1, rate: 0.5, publish_every: 1 });
  await daemon.command("thousand", "run");
  const tab = await openTab(browser);
  await tab.page.addInitScript(countStates);
  await tab.page.goto(`${daemon.told.http}/#/swarm/thousand`);
  const count = () => tab.page.evaluate<Count>("({ ...count })");
  await until("pictures", async () => (await count()).drawn > 25);
  const [first, begin] = [(await status("thousand")).step, await count()];
  const seconds: Count[] = [];
  let before = begin;
  for (let k = 0; k < SECONDS; k += 1) {
    await tab.page.waitForTimeout(1000);
    const now = await count();
    seconds.push(less(now, before));
    before = now;
  }
  const [published, all] = [(await status("thousand")).step - first, less(before, begin)];
  await tab.close();
  await daemon.command("thousand", "delete");
  const each = seconds.map((it) => `${it.drawn}/${it.received} ${it.pictures}`).join(", ");
  t.diagnostic(`of ${published} states ${JSON.stringify(all)}; load ${loadavg()[0]?.toFixed(1)}`);
  t.diagnostic(`states drawn/received and pictures of each second: ${each}`);
  assert(published > 20 * SECONDS, `${published} states in ${SECONDS} s`);
  assert(all.received >= RECEIVED * published, `${all.received} of ${published} states received`);
  assert(all.drawn >= DRAWN * all.received, `${all.drawn} of ${all.received} states drawn`);
  const { pictures } = all;
  assert(pictures >= PICTURES * all.received, `${pictures} pictures of ${all.received} states`);
});

function less(now: Count, before: Count): Count {
  return {
    received: now.received - before.received,
    drawn: now.drawn - before.drawn,
    pictures: now.pictures - before.pictures,
  };
}

test("fifty tabs receive every state at once, and one that reads nothing holds up nobody", async (t) => {
  const STATES = 300;
  await daemon.create("crowd", { n: 50, seed: 1, rate: 2, publish_every: 2 });
  const asleep = await deaf("crowd");
  const tab = await openTab(browser);
  await tab.page.goto(`${daemon.told.http}/#/`);
  await tab.page.evaluate(openSockets, 50);
  const counts = () => tab.page.evaluate<number[]>("states");
  // The state that stands comes first.
  await until("a state in each", async () => (await counts()).every((it) => it > 0));
  const began = await counts();
  await daemon.command("crowd", "run", { until_step: 2 * STATES });
  await until("the last step", async () => (await status("crowd")).phase === "paused", 60_000);
  assert.equal((await status("crowd")).step, 2 * STATES);
  const least = async () => Math.min(...(await counts()).map((it, k) => it - began[k]!));
  await until("every state in each", async () => (await least()) >= RECEIVED * STATES);
  const each = (await counts()).map((it, k) => it - began[k]!);
  t.diagnostic(`of ${STATES} states ${Math.min(...each)} to ${Math.max(...each)}`);
  assert.equal(asleep.bytesRead, 0);
  await tab.close();
  asleep.destroy();
  await daemon.command("crowd", "delete");
});

/** Runs in the page: opens sockets as so many tabs would, and counts what each is told. */
function openSockets(count: number): void {
  const states = new Array<number>(count).fill(0);
  Object.assign(globalThis, { states });
  for (let k = 0; k < count; k += 1) {
    const socket = new WebSocket(`ws://${location.host}/api/ws?swarm=crowd`);
    socket.onmessage = ({ data }) => {
      states[k]! += typeof data === "string" ? 0 : 1;
    };
  }
}

/** A tab that was stopped: it asked for the socket and reads nothing. */
async function deaf(swarm: string): Promise<Socket> {
  const { hostname, port } = new URL(daemon.told.http);
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
