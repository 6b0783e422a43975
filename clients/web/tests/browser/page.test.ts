/** The page in Chromium, against a daemon. */
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { type Tab, tabsOfEachTest, until } from "./browser.ts";
import { Daemon, DYNAMIC_USER, isRoot } from "./daemon.ts";

interface StateJson {
  step: number;
  id: number[];
  x: number[];
  y: number[];
  weight: number[];
  direction: number[];
}

interface Rows {
  result: { swarms: { swarm: string; phase: string; step: number; n: number }[] };
}

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
  await daemon.create("school", { n: 40, seed: 3, rate: 5, publish_every: 5 });
});

after(() => daemon.end());

async function openTabAt(hash: string, token = true): Promise<Tab> {
  const tab = await openTab();
  await tab.page.goto(token ? `${daemon.link}&${hash}` : `${daemon.told.http}/#${hash}`);
  return tab;
}

const open = async (hash: string, token = true) => (await openTabAt(hash, token)).page;

const number = (page: Page, name: string) => page.locator(`dd[data-number="${name}"]`).first();
const step = async (page: Page) => Number(await number(page, "step").textContent());
const row = async (name: string) =>
  (await daemon.get<Rows>("@node/get/swarms")).result.swarms.find((it) => it.swarm === name);
const state = (name: string) => daemon.get<StateJson>(`${name}/state?format=json`);

test("the list shows the swarm, and a click opens it", async () => {
  await daemon.command("school", "run");
  const page = await open("/");
  const card = page.locator('[data-swarm="school"]');
  await card.waitFor();
  await until("the phase", async () => (await card.textContent())?.includes("running"));
  assert.match((await card.textContent()) ?? "", /n 40/);
  const line = card.locator("polyline");
  await until("a sparkline", async () => ((await line.getAttribute("points")) ?? "").includes(" "));
  await card.click();
  await page.locator("h1", { hasText: "school" }).waitFor();
});

test("a running swarm is followed: its step, time and pictures go on", async () => {
  await daemon.command("school", "run");
  const page = await open("/swarm/school");
  const first = await until("a step", () => step(page));
  await until("later steps", async () => (await step(page)) > first + 50);
  const fps = page.locator(".meter");
  await until("pictures", async () => Number(await fps.getAttribute("data-fps")) > 5);
  assert.equal(
    await page.getByRole("button", { name: "Follow" }).getAttribute("aria-pressed"),
    "true",
  );
  assert.equal(await page.evaluate("location.href.includes('token')"), false);
  assert.equal(await page.evaluate("localStorage.length"), 0);
});

test("space pauses and runs, s takes a step", async () => {
  await daemon.command("school", "run");
  const page = await open("/swarm/school");
  const runs = page.locator("button.wide");
  await until("the button", async () => (await runs.textContent())?.includes("Pause"));
  await page.locator("canvas.picture").focus();
  await page.keyboard.press(" ");
  await until("a pause", async () => (await row("school"))?.phase === "paused");
  await until("its button", async () => (await runs.textContent())?.includes("Run"));
  const before = (await state("school")).step;
  await page.keyboard.press("s");
  await until("a step", async () => (await state("school")).step === before + 1);
  await until("its number", async () => (await step(page)) === before + 1);
  await page.keyboard.press(" ");
  await until("running", async () => (await row("school"))?.phase === "running");
});

test("keys show contacts, clusters and trails, and leave and return to following", async () => {
  const page = await open("/swarm/school");
  await until("a state", () => step(page));
  const pressed = (name: string) =>
    page.getByRole("button", { name, exact: true }).getAttribute("aria-pressed");
  for (const [key, name] of [
    ["c", "Contacts"],
    ["k", "Clusters"],
    ["t", "Trails"],
  ] as const) {
    await page.keyboard.press(key);
    assert.equal(await pressed(name), "true");
  }
  await page.keyboard.press("ArrowLeft");
  assert.equal(await pressed("Follow"), "false");
  await page.keyboard.press("f");
  assert.equal(await pressed("Follow"), "true");
  const scale = async () => Number(await page.locator("canvas.picture").getAttribute("data-scale"));
  const fitted = await scale();
  await page.keyboard.press("+");
  await until("a larger scale", async () => (await scale()) > fitted);
  await page.keyboard.press("?");
  await page.locator("dialog").waitFor();
  await page.keyboard.press("Escape");
  await until("no dialog", async () => (await page.locator("dialog").count()) === 0);
});

test("without a token nothing can be commanded, and the daemon refuses it, too", async () => {
  await daemon.command("school", "run");
  const page = await open("/swarm/school", false);
  await until("a state", () => step(page));
  for (const name of [
    "Pause",
    "Step",
    "Inject",
    "Fork",
    "Delete",
    "Inform",
    "Uninform",
    "Add note",
  ]) {
    const button = page.locator(".panels button", { hasText: name }).first();
    assert.equal(await button.isDisabled(), true, name);
  }
  assert.equal(await page.locator(".parameters button").count(), 0);
  await page.getByText("this tab needs the daemon's token").first().waitFor();
  await page.keyboard.press(" ");
  for (const token of [null, "0".repeat(32)]) {
    const refused = await daemon.post("/api/cmd/school/pause", {}, token);
    assert.equal(refused.status, 401);
    assert.equal(((await refused.json()) as { code: string }).code, "permission_denied");
  }
  assert.equal((await row("school"))?.phase, "running");
});

test("a token can be pasted, with the link around it", async () => {
  const page = await open("/swarm/school", false);
  await page.locator(".rights").click();
  await page.locator("dialog input").fill(daemon.link);
  await page.locator("dialog button.primary").click();
  await until("rights", async () => !(await page.locator("button.wide").isDisabled()));
  await page.reload();
  await until("rights after all", async () => !(await page.locator("button.wide").isDisabled()));
});

test("a page without a token says what is missing, and the command that prints the link", async (t) => {
  const service = await Daemon.startAsService();
  // After the tabs are closed: an open page would log connection errors.
  t.after(() => service.end());
  const { http, token } = service.told;
  const { page } = await visit(http);
  await page.getByText("You are watching: to run, steer, create or delete swarms").waitFor();
  await page.getByText("This daemon has no swarms.").waitFor();
  assert.equal(await page.getByRole("button", { name: "Create a swarm" }).isVisible(), false);
  const command = (await page.locator(".shell code").textContent()) ?? "";
  // What belongs to a service takes root; for root `sudo` is nothing.
  assert.equal(command.includes("$(sudo cat "), isRoot, command);
  const line = isRoot ? command.replace("sudo ", "") : command;
  const printed = execFileSync("sh", ["-c", line]).toString();
  assert.equal(printed, `${http}/#token=${token}\n`);
  if (isRoot) {
    // Another user of the machine reads nothing.
    const other = { uid: DYNAMIC_USER + 1, gid: DYNAMIC_USER + 1, stdio: "pipe" } as const;
    assert.equal(execFileSync("sh", ["-c", line], other).toString(), `${http}/#token=\n`);
  }

  // What it prints may be pasted, also with what a terminal puts around it.
  await page.getByRole("button", { name: "paste the link" }).click();
  assert.equal(await page.locator("dialog .shell code").textContent(), command);
  await page.locator("dialog input").fill(` ${printed}`);
  await page.locator("dialog button.primary").click();
  await page.getByRole("button", { name: "Create a swarm" }).waitFor();
  assert.equal(await page.locator(".shell").filter({ visible: true }).count(), 0);

  const opened = await visit(printed.trim());
  await opened.page.getByRole("button", { name: "Create a swarm" }).waitFor();

  // A link that was printed for another daemon.
  const stale = await visit(`${http}/#token=${"0".repeat(32)}`);
  await stale.page.getByText("the token of this tab is not this daemon's").waitFor();
  assert.equal(await stale.page.locator(".shell code").textContent(), command);
});

async function visit(address: string): Promise<Tab> {
  const tab = await openTab();
  await tab.page.goto(address);
  return tab;
}

test("where people are known each sees and may what their role says", async (t) => {
  const folder = mkdtempSync(join(tmpdir(), "jostle-people-"));
  const auth = join(folder, "auth");
  const jostled = process.env.JOSTLED ?? "";
  const people = ["vera=viewer", "olga=operator"];
  execFileSync(jostled, ["--auth-dir", auth, "auth", "init", ...people]);
  const lab = await Daemon.start(auth);
  t.after(async () => {
    await lab.end();
    rmSync(folder, { recursive: true, force: true });
  });
  const token = (person: string): string => {
    const file = join(auth, "people", person, "credentials.json");
    return (JSON.parse(readFileSync(file, "utf8")) as { token: string }).token;
  };
  const spec = { name: "school", spec: { n: 10, seed: 1 } };
  const created = await lab.post("/api/node/create", spec, token("olga"));
  assert.equal(created.status, 200);

  const stranger = await openTab();
  // A WebSocket without a token is rejected, and tried again.
  stranger.expectsError(
    /^WebSocket connection to '\S+\/api\/ws' failed: HTTP Authentication failed/,
    Number.POSITIVE_INFINITY,
  );
  await stranger.page.goto(lab.told.http);
  await stranger.page.getByText("shows itself only to people that it knows").first().waitFor();
  assert.equal(await stranger.page.getByText("school").count(), 0);
  // The command that it names is carried out, as vera would with her folder.
  const command = (await stranger.page.locator(".shell code").first().textContent()) ?? "";
  assert.match(command, /^jostle --credentials FOLDER auth link --page http:\/\/127/);
  const vera_link = execFileSync("sh", ["-c", command.replace("FOLDER", `${auth}/people/vera`)], {
    env: {
      ...process.env,
      PATH: `${dirname(jostled)}:${process.env.PATH}`,
      JOSTLE_ENDPOINT: lab.told.zenoh,
    },
  });
  assert.equal(vera_link.toString().trim(), `${lab.told.http}/#token=${token("vera")}`);

  const enter = async (person: string): Promise<Page> => {
    const tab = await openTab();
    await tab.page.goto(`${lab.told.http}/#token=${token(person)}&/swarm/school`);
    await tab.page.getByText(`${person}, `).first().waitFor();
    return tab.page;
  };
  const vera = await enter("vera");
  await vera.getByText("You are vera, viewer: commanding takes an operator.").first().waitFor();
  await until("vera sees the swarm", async () => (await step(vera)) === 0);
  const olga = await enter("olga");
  await olga.keyboard.press("s");
  await until("vera sees what olga does", async () => (await step(vera)) === 1);
  await vera.keyboard.press("s");
  await olga.keyboard.press("s");
  await until("and vera does nothing", async () => (await step(vera)) === 2);
  assert.equal((await lab.post("/api/cmd/school/pause", {}, token("vera"))).status, 403);
});

test("a lasso informs exactly the individuals it encloses", async () => {
  await daemon.create("herd", { n: 30, seed: 8, pi1: 4 });
  await daemon.command("herd", "step", { steps: 200 });
  const page = await open("/swarm/herd");
  await until("a state", () => step(page));
  const at = await state("herd");
  const canvas = page.locator("canvas.picture");
  const box = (await canvas.boundingBox())!;
  const scale = Number(await canvas.getAttribute("data-scale"));
  const mean = (column: number[]) => column.reduce((sum, it) => sum + it, 0) / column.length;
  const [mx, my] = [mean(at.x), mean(at.y)];
  const screen = at.id.map((id, i) => ({
    id,
    left: box.width / 2 + (at.x[i]! - mx) * scale,
    top: box.height / 2 - (at.y[i]! - my) * scale,
  }));
  // A triangle about part of the group, no centre too near its sides.
  const corners = [
    [box.width * 0.5, box.height * 0.02],
    [box.width * 0.04, box.height * 0.6],
    [box.width * 0.62, box.height * 0.95],
  ] as const;
  const expected = screen.filter((it) => inTriangle(it.left, it.top, corners)).map(({ id }) => id);
  assert(expected.length > 2 && expected.length < 28, `${expected.length} are enclosed`);

  await page.keyboard.press("l");
  await drag(page, box, [...corners, corners[0]]);
  await page.getByText(`${expected.length} individuals selected`).waitFor();
  await page.getByLabel("weight").fill("0.75");
  // The direction: up and to the right, 45 degrees from +x.
  await drag(page, box, [
    [100, 200],
    [180, 120],
  ]);
  const informed = await until("who is informed", async () => {
    const now = await state("herd");
    return now.weight.some((it) => it > 0) && now;
  });
  assert.deepEqual(
    informed.id.filter((_, i) => informed.weight[i]! > 0),
    expected,
  );
  informed.weight.forEach((weight, i) => {
    assert.equal(weight, expected.includes(informed.id[i]!) ? 0.75 : 0);
    if (weight > 0) {
      assert(Math.abs(informed.direction[i]! - Math.PI / 4) < 1e-6);
    }
  });
  await page.locator("button", { hasText: "Uninform" }).click();
  await until("nobody informed", async () => (await state("herd")).weight.every((it) => it === 0));
});

function inTriangle(
  x: number,
  y: number,
  corners: readonly (readonly [number, number])[],
): boolean {
  const sides = corners.map(([ax, ay], k) => {
    const [bx, by] = corners[(k + 1) % 3]!;
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax);
  });
  return sides.every((it) => it > 0) || sides.every((it) => it < 0);
}

async function drag(
  page: Page,
  box: { x: number; y: number },
  places: readonly (readonly [number, number])[],
): Promise<void> {
  const [first, ...rest] = places;
  await page.mouse.move(box.x + first![0], box.y + first![1]);
  await page.mouse.down();
  for (const [x, y] of rest) {
    await page.mouse.move(box.x + x, box.y + y, { steps: 12 });
  }
  await page.mouse.up();
}

test("a parameter is set, and a refusal is said in the daemon's words", async () => {
  const tab = await openTabAt("/swarm/herd");
  tab.expectsError(/^400 POST \/api\/cmd\/herd\/set$/);
  const { page } = tab;
  const field = page.getByLabel("pi3", { exact: true });
  await field.fill("1.5");
  await page.getByRole("button", { name: "set pi3" }).click();
  const parameter = page.locator(".parameter", { hasText: "Body size over turning radius" });
  await until("its value", async () => (await parameter.locator("output").textContent()) === "1.5");
  await field.fill("0");
  await page.getByRole("button", { name: "set pi3" }).click();
  await page.locator(".errors", { hasText: "pi3" }).waitFor();
  const applied = page.locator(".events li", { hasText: "set pi3 1.5" });
  await applied.waitFor();
  const clock = applied.locator(".clock");
  const at = await clock.getAttribute("title");
  assert.ok(Math.abs(Date.parse(at ?? "") - Date.now()) < 60_000, `the event has the time ${at}`);
  assert.equal(await clock.textContent(), `${at?.slice(11, 19)}Z`);
});

test("a note is added and stands among the events", async () => {
  const page = await open("/swarm/herd");
  const field = page.getByLabel("note in the journal");
  await field.fill("lights off, s and space are no keys here");
  await page.getByRole("button", { name: "Add note" }).click();
  const noted = page.locator(".events li", { hasText: "note: lights off, s and space" });
  await noted.waitFor();
  await until("an empty field", async () => (await field.inputValue()) === "");
});

test("a swarm is created, forked and deleted, the last after a question", async () => {
  const page = await open("/");
  await page.getByRole("button", { name: "Create a swarm" }).click();
  await page.locator("dialog input").first().fill("made");
  await page.locator("dialog").getByRole("button", { name: "Create" }).click();
  await page.locator("h1", { hasText: "made" }).waitFor();
  await until("it runs", async () => (await row("made"))?.phase === "running");
  await page.getByRole("button", { name: "Fork" }).click();
  await page.locator("h1", { hasText: "made-fork" }).waitFor();
  assert.equal((await row("made-fork"))?.phase, "paused");
  await page.getByRole("button", { name: "Delete" }).click();
  await page.getByRole("button", { name: "Keep it" }).click();
  assert(await row("made-fork"));
  await page.getByRole("button", { name: "Delete" }).click();
  await page.locator("dialog button.danger").click();
  await until("it is gone", async () => !(await row("made-fork")));
  await page.locator("h1", { hasText: "Swarms" }).waitFor();
  await daemon.command("made", "delete");
});

test("a swarm that goes is missed, and another of its name is shown", async () => {
  await daemon.create("brief", { n: 12 });
  const page = await open("/swarm/brief");
  await until("its size", async () => (await number(page, "n").textContent()) === "12");
  // A request that is sent before the deletion may be answered by 404.
  await page.waitForLoadState("networkidle");
  await daemon.command("brief", "delete");
  await page.getByText("There is no swarm brief now").waitFor();
  await daemon.create("brief", { n: 7 });
  await until("its size", async () => (await number(page, "n").textContent()) === "7");
  await until("no veil", async () => (await page.locator(".stage.dimmed").count()) === 0);
  await until("its events", async () => (await page.locator(".events li").count()) === 1);
  await daemon.command("brief", "delete");
});

test("no events of a deleted swarm are requested", async () => {
  await daemon.create("brief", { n: 12 });
  const tab = await openTab();
  let release: () => void = () => {};
  const deleted = new Promise<void>((resolve) => {
    release = resolve;
  });
  let requests = 0;
  // The first reply arrives after the event that the swarm was deleted.
  await tab.page.route(/\/get\/events/, async (route) => {
    requests += 1;
    const response = await route.fetch();
    await deleted;
    await route.fulfill({ response });
  });
  await tab.page.goto(`${daemon.link}&/swarm/brief`);
  await until("its size", async () => (await number(tab.page, "n").textContent()) === "12");
  await daemon.command("brief", "delete");
  await tab.page.getByText("There is no swarm brief now").waitFor();
  release();
  await tab.page.waitForLoadState("networkidle");
  await tab.page.locator(".events li", { hasText: "deleted" }).waitFor();
  assert.equal(requests, 1);
});

test("a swarm is shown as contested while another daemon holds its name", async () => {
  await daemon.create("held", { n: 12 });
  const tab = await openTab();
  let rival: string | null = "lab-2";
  // Forwards the daemon's messages, with `contested_by` set as if another daemon held the name.
  await tab.page.routeWebSocket(/.*/, (socket) => {
    const server = socket.connectToServer();
    server.onMessage((message) => {
      if (typeof message !== "string") {
        return socket.send(message);
      }
      const told: { swarms?: { swarm: string; contested_by: string | null }[] } =
        JSON.parse(message);
      for (const it of told.swarms ?? []) {
        it.contested_by = it.swarm === "held" ? rival : null;
      }
      socket.send(JSON.stringify(told));
    });
  });
  await tab.page.goto(`${daemon.link}&/`);
  const card = tab.page.locator('[data-swarm="held"]');
  await until("the card says it", async () =>
    (await card.textContent())?.includes("contested by daemon lab-2"),
  );
  await card.click();
  await tab.page.getByText("Contested: daemon lab-2 has a swarm held, too.").waitFor();
  assert.equal(await tab.page.locator(".stage.dimmed").count(), 1);
  rival = null;
  await until("no veil", async () => (await tab.page.locator(".stage.dimmed").count()) === 0);
  assert.equal(await number(tab.page, "n").textContent(), "12");
  await daemon.command("held", "delete");
});

test("light and dark are the system's, until they are switched", async () => {
  const page = await open("/");
  const theme = () => page.evaluate("document.documentElement.dataset.theme");
  assert.equal(await theme(), "light");
  await page.emulateMedia({ colorScheme: "dark" });
  await until("dark", async () => (await theme()) === "dark");
  await page.getByRole("button", { name: "switch to light" }).click();
  assert.equal(await theme(), "light");
  await page.reload();
  assert.equal(await theme(), "light");
});

test("the gallery makes an animation with one click, and shows one that is there", async () => {
  const page = await open("/gallery");
  const card = page.locator('[data-swarm="animation-6-discs"]');
  await card.getByRole("button", { name: "Create and run it" }).click();
  await page.locator("h1", { hasText: "discs" }).waitFor();
  await until("it runs", async () => (await row("animation-6-discs"))?.phase === "running");
  await until("its order", async () => Number(await number(page, "order").textContent()) >= 0);
  await page.getByText("What to look for").waitFor();
  await page.goto(`${daemon.told.http}/#/gallery`);
  await card.getByRole("button", { name: "Show it" }).waitFor();
  await daemon.command("animation-6-discs", "delete");
});

test("the daemon's end dims the picture, and its return goes on by itself", async () => {
  await daemon.command("school", "run");
  const tab = await openTabAt("/swarm/school");
  const { page } = tab;
  await until("a state", () => step(page));
  // When the connection is lost the page requests /api/hello, and reconnects until the daemon is back.
  // What the page has requested since it was opened may be in flight when the daemon is killed.
  const ends = "net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE)";
  const reads = "get/school/get/(parameters|events\\?after=\\d+&limit=256)";
  tab.expectsError(new RegExp(`^Failed to load resource: ${ends} /api/hello$`), 2);
  tab.allowsError(new RegExp(`^Failed to load resource: ${ends} /api/${reads}$`));
  tab.allowsError(
    /^WebSocket connection to '\S+\/api\/ws\?swarm=school' failed: .*net::ERR_CONNECTION_REFUSED$/,
  );
  await daemon.kill();
  await page.getByText("The daemon is away, trying again").first().waitFor();
  assert.equal(await page.locator(".stage.dimmed").count(), 1);
  assert((await step(page)) > 0, "the last numbers stay");
  await daemon.again();
  await until("the picture", async () => (await page.locator(".stage.dimmed").count()) === 0);
  const back = await step(page);
  await until("later steps", async () => (await step(page)) > back + 20);
  await page.keyboard.press(" ");
  await until("it still commands", async () => (await row("school"))?.phase === "paused");
});

test("on a phone nothing is wider than the screen", async () => {
  for (const hash of ["/", "/swarm/school", "/gallery", "/gallery/animation-1"]) {
    const tab = await openTab({ viewport: { width: 360, height: 740 }, hasTouch: true });
    if (hash === "/gallery/animation-1") {
      // There is no such swarm: the page may request its parameters before the daemon says so.
      tab.allowsError(/^404 GET \/api\/get\/animation-1\/get\/parameters$/);
    }
    await tab.page.goto(`${daemon.link}&${hash}`);
    await tab.page.locator("h1").first().waitFor();
    await tab.page.waitForTimeout(300);
    assert.equal(await tab.page.evaluate("document.documentElement.scrollWidth"), 360, hash);
  }
});

test("a replay is shown like a swarm, says where it is, and goes where the slider is put", async () => {
  await daemon.create("filmed", { n: 10, seed: 4, rate: 20, publish_every: 1 });
  const recorded = daemon.jostle("record", "filmed", "-o", "film.mcap", "--steps", "60");
  await daemon.command("filmed", "run");
  await recorded;
  await daemon.jostle("replay", "film.mcap", "--as", "film", "--paused");

  const page = await open("/swarm/film");
  const slider = page.getByRole("slider", { name: "place in the recording" });
  await slider.waitFor();
  await page.locator(".tape", { hasText: "replay of filmed" }).waitFor();
  assert.equal(await page.getByRole("button", { name: "Inject" }).isVisible(), false);
  const first = (await row("film"))?.step ?? 0;
  await slider.focus();
  await page.keyboard.press("End");
  const last = await until("it is at its end", async () => {
    const { step } = (await row("film")) ?? {};
    return step !== undefined && step > first + 50 ? step : null;
  });
  await until("the page shows it", async () => (await step(page)) === last || null);
  await page.keyboard.press("Home");
  await until("it is back", async () => ((await row("film"))?.step ?? last) < last - 50 || null);
  await page.getByRole("button", { name: "Run", exact: false }).first().click();
  await until("it has run to its end", async () => (await step(page)) === last || null);

  const stranger = await open("/swarm/film", false);
  const theirs = stranger.getByRole("slider", { name: "place in the recording" });
  await theirs.waitFor();
  assert.equal(await theirs.isDisabled(), true);
});

test("a line of the list begins when the page is opened and grows", async () => {
  const points = async (page: Page) => {
    const line = page.locator('[data-swarm="school"] .sparkline polyline');
    return ((await line.getAttribute("points")) ?? "").split(" ").length;
  };
  const before = await open("/");
  await until("a few", async () => (await points(before)) > 10);
  const page = await open("/");
  await page.locator('[data-swarm="school"]').waitFor();
  assert((await points(page)) < 5);
  await until("more", async () => (await points(page)) > 5);
});

test("after a lasso the key for directions leaves what it has begun", async () => {
  await daemon.command("school", "pause");
  const page = await open("/swarm/school");
  await page.locator("canvas.picture").waitFor();
  await page.keyboard.press("l");
  const { x, y, width, height } = (await page.locator("canvas.picture").boundingBox()) ?? {
    x: 0,
    y: 0,
    width: 0,
    height: 0,
  };
  const at = (share_x: number, share_y: number) =>
    page.mouse.move(x + share_x * width, y + share_y * height, { steps: 4 });
  await at(0.02, 0.02);
  await page.mouse.down();
  await at(0.8, 0.02);
  await at(0.8, 0.98);
  await at(0.02, 0.98);
  await at(0.02, 0.02);
  await page.mouse.up();
  await page.locator(".hint", { hasText: "Drag the direction" }).waitFor();
  await page.keyboard.press("d");
  await page.locator(".hint", { hasText: "Drag the direction" }).waitFor();
  await page.keyboard.press("Escape");
});
