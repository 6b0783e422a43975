/** Swarms and daemons that appear and disappear, and playbacks. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import type { Page } from "playwright-core";
import { until } from "./browser.ts";
import { number, Site, step } from "./site.ts";

/** Of version 1 of the model, at step 60. */
const EARLIER = new URL("../../../../../tests/stored/earlier.snapshot", import.meta.url);

const site = new Site();

test("a swarm is created, forked, and deleted after a confirmation", async () => {
  const tab = await site.openTabAt("/");
  // A thumbnail may be requested while its swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/made(-fork)?\/(state|get\/status)$/);
  const { page } = tab;
  await page.getByRole("button", { name: "Create a swarm" }).click();
  await page.locator("dialog input").first().fill("made");
  await page.locator("dialog").getByRole("button", { name: "Create" }).click();
  await page.locator("h1", { hasText: "made" }).waitFor();
  await until("it runs", async () => (await site.row("made"))?.phase === "running");
  await page.getByRole("button", { name: "Fork" }).click();
  await page.locator("h1", { hasText: "made-fork" }).waitFor();
  assert.equal((await site.row("made-fork"))?.phase, "paused");
  await page.getByRole("button", { name: "Delete" }).click();
  await page.getByRole("button", { name: "Cancel" }).click();
  assert(await site.row("made-fork"));
  await page.getByRole("button", { name: "Delete" }).click();
  await page.locator("dialog button.danger").click();
  await until("the deletion", async () => !(await site.row("made-fork")));
  await page.locator("h1", { hasText: "Swarms" }).waitFor();
  await site.daemon.command("made", "delete");
});

test("a deleted swarm is reported missing, and a new one of its name is shown", async () => {
  await site.daemon.create("brief", { n: 12 });
  const tab = await site.openTabAt("/swarm/brief");
  // A request may be under way when its swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/brief\//);
  const { page } = tab;
  await until("its size", async () => (await number(page, "n").textContent()) === "12");
  await site.daemon.command("brief", "delete");
  await page.getByText("No swarm brief on this daemon").waitFor();
  await site.daemon.create("brief", { n: 7 });
  await until("its size", async () => (await number(page, "n").textContent()) === "7");
  await until(
    "no showAvailability",
    async () => (await page.locator(".view.dimmed").count()) === 0,
  );
  await until("its events", async () => (await page.locator(".events li").count()) === 1);
  await site.daemon.command("brief", "delete");
});

test("the fork of a swarm with the longest name has a name that is accepted", async () => {
  const name = `l${"o".repeat(62)}ng`.slice(0, 64);
  await site.daemon.create(name, { n: 3 });
  const page = await site.open(`/swarm/${name}`);
  await until("its size", async () => (await number(page, "n").textContent()) === "3");
  await page.getByRole("button", { name: "Fork", exact: true }).click();
  const fork = `${name.slice(0, 58)}-fork`;
  const forked = async () => (await site.daemon.get<{ swarm: string }>(`${fork}/get/status`)).swarm;
  await until("the fork", async () => (await forked().catch(() => "")) === fork);
  await site.daemon.command(name, "delete");
  await site.daemon.command(fork, "delete");
});

test("a protected swarm is shown as such, and neither deleted nor reset", async () => {
  await site.daemon.create("dear", { n: 3 });
  const tab = await site.openTabAt("/swarm/dear");
  tab.allowsError(/^409 POST \/api\/cmd\/dear\/delete$/);
  // A thumbnail may be requested while its swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/dear\//);
  const { page } = tab;
  const press = (name: string) => page.getByRole("button", { name, exact: true });
  const shown = page.locator(".page-head").getByText("protected", { exact: true });
  const isEnabled = () => Promise.all(["Reset …", "Delete …"].map((it) => press(it).isEnabled()));
  await until("its size", async () => (await number(page, "n").textContent()) === "3");
  assert.equal(await shown.isVisible(), false);
  await until("enabled buttons", async () => (await isEnabled()).every(Boolean));

  // A dialog that was open before: the daemon rejects the command.
  await press("Delete …").click();
  await site.daemon.command("dear", "protect", { on: true });
  await shown.waitFor();
  await page.locator("dialog button.danger").click();
  await page.getByText("jostle protect --off dear").first().waitFor();
  assert(await site.row("dear"));
  assert.deepEqual(await isEnabled(), [false, false]);
  await page.getByText("Protected from Reset and Delete.").waitFor();
  await page.locator(".events li", { hasText: "protected from delete and reset" }).waitFor();
  await page.goto(page.url().replace(/#.*/, "#/"));
  await page.locator(".swarm-card[data-swarm=dear] .facts", { hasText: "protected" }).waitFor();
  await page.goto(page.url().replace(/#.*/, "#/swarm/dear"));

  await press("End protection").click();
  await shown.waitFor({ state: "hidden" });
  assert.deepEqual(await isEnabled(), [true, true]);
  await press("Protect").click();
  await shown.waitFor();
  await press("End protection").click();
  await press("Protect").waitFor();
  await press("Delete …").click();
  await page.locator("dialog button.danger").click();
  await until("the deletion", async () => !(await site.row("dear")));
});

test("a swarm with steps of an earlier version of the model is marked until a reset", async () => {
  await site.daemon.jostle("restore", fileURLToPath(EARLIER), "old");
  const tab = await site.openTabAt("/");
  // A thumbnail may be requested while its swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/old\//);
  const { page } = tab;
  const mark = (of: string) => page.locator(of).getByText("model 1 until step 60", { exact: true });
  const card = ".swarm-card[data-swarm=old] .facts";
  const facts = page.locator(card);
  const shown = mark(".page-head");
  await mark(card).waitFor();
  assert.equal(await page.locator(".facts", { hasText: "until step" }).count(), 1);

  await page.goto(page.url().replace(/#.*/, "#/swarm/old"));
  await shown.waitFor();
  await site.daemon.command("old", "step", { steps: 5 });
  await until("its step", async () => (await number(page, "step").textContent()) === "65");
  assert(await shown.isVisible());
  // After a restart it goes on from a checkpoint of this version.
  tab.allowsError(/net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE)|code: 429/);
  await site.daemon.kill("SIGTERM");
  await page.locator(".view.dimmed").waitFor();
  await site.daemon.restart();
  await until("the picture", async () => (await page.locator(".view.dimmed").count()) === 0);
  await shown.waitFor();

  await site.daemon.command("old", "reset");
  await shown.waitFor({ state: "hidden" });
  await page.goto(page.url().replace(/#.*/, "#/"));
  await facts.getByText("n 12", { exact: true }).waitFor();
  assert.equal(await mark(card).count(), 0);
  await site.daemon.command("old", "delete");
});

for (const verb of ["Delete", "Reset"]) {
  test(`${verb} … spares another swarm of the same name`, async () => {
    await site.daemon.create("brief", { n: 12 });
    await site.daemon.command("brief", "step", { steps: 5 });
    const tab = await site.openTab();
    // A request may be under way when its swarm is deleted.
    tab.allowsError(/^404 GET \/api\/get\/brief\//);
    const { page } = tab;
    let isLate = false;
    // Once it is late the page gets no more messages.
    await page.routeWebSocket(/\/api\/ws/, (socket) => {
      socket.connectToServer().onMessage((message) => {
        if (!isLate) {
          socket.send(message);
        }
      });
    });
    const sent: string[] = [];
    page.on("request", (it) => {
      if (it.method() === "POST") {
        sent.push(it.url());
      }
    });
    await page.goto(`${site.daemon.link}&/swarm/brief`);
    const refusal = page.locator(".errors", { hasText: "brief that you saw was deleted" });
    const another = async () => {
      await site.daemon.command("brief", "delete");
      if (!isLate) {
        await page.getByText("No swarm brief on this daemon").waitFor();
        assert.match((await page.locator(".selection").textContent()) ?? "", /^No individual/);
      }
      await site.daemon.create("brief", { n: 7 });
      await site.daemon.command("brief", "step", { steps: 3 });
    };

    // The page gets the message that the swarm was deleted: the dialog closes.
    await until("its size", async () => (await number(page, "n").textContent()) === "12");
    await page.getByRole("button", { name: "Select all", exact: true }).click();
    await page.locator(".selection", { hasText: "12 individuals" }).waitFor();
    await page.getByRole("button", { name: `${verb} …` }).click();
    await page.locator("dialog button.danger").waitFor();
    await another();
    await refusal.waitFor();
    assert.equal(await page.locator("dialog").count(), 0);

    // The message is late: the dialog stays, and sends nothing.
    await until("its size", async () => (await number(page, "n").textContent()) === "7");
    await until("its events", async () => (await page.locator(".events li").count()) === 2);
    await page.locator(".errors").getByRole("button", { name: "close" }).click();
    await page.getByRole("button", { name: `${verb} …` }).click();
    isLate = true;
    await another();
    await page.locator("dialog button.danger").click();
    await refusal.waitFor();
    assert.deepEqual(sent, []);
    assert.equal((await site.row("brief"))?.step, 3);
    await site.daemon.command("brief", "delete");
  });
}

test("no events of a deleted swarm are requested", async () => {
  await site.daemon.create("brief", { n: 12 });
  const tab = await site.openTab();
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
  await tab.page.goto(`${site.daemon.link}&/swarm/brief`);
  await until("its size", async () => (await number(tab.page, "n").textContent()) === "12");
  await site.daemon.command("brief", "delete");
  await tab.page.getByText("No swarm brief on this daemon").waitFor();
  release();
  await tab.page.waitForLoadState("networkidle");
  await tab.page.locator(".events li", { hasText: "deleted" }).waitFor();
  assert.equal(requests, 1);
});

test("a swarm is shown as contested while another daemon claims its name", async () => {
  await site.daemon.create("held", { n: 12 });
  const tab = await site.openTab();
  // Events and thumbnails may be requested while the swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/held\//);
  let rival: string | null = "lab-2";
  // Forwards the daemon's messages, with `contested_by` set as if another daemon held the name.
  await tab.page.routeWebSocket(/.*/, (socket) => {
    const server = socket.connectToServer();
    server.onMessage((message) => {
      if (typeof message !== "string") {
        return socket.send(message);
      }
      const message_json: { swarms?: { swarm: string; contested_by: string | null }[] } =
        JSON.parse(message);
      for (const it of message_json.swarms ?? []) {
        it.contested_by = it.swarm === "held" ? rival : null;
      }
      socket.send(JSON.stringify(message_json));
    });
  });
  await tab.page.goto(`${site.daemon.link}&/`);
  const card = tab.page.locator('[data-swarm="held"]');
  await until("the contested card", async () =>
    (await card.textContent())?.includes("contested by daemon lab-2"),
  );
  await card.click();
  await tab.page.getByText("Contested: daemon lab-2 also has a swarm held.").waitFor();
  assert.equal(await tab.page.locator(".view.dimmed").count(), 1);
  rival = null;
  await until(
    "no showAvailability",
    async () => (await tab.page.locator(".view.dimmed").count()) === 0,
  );
  assert.equal(await number(tab.page, "n").textContent(), "12");
  await site.daemon.command("held", "delete");
});

test("a playback shows its position, and the slider seeks", async () => {
  await site.daemon.create("filmed", { n: 10, seed: 4, rate: 20, publish_every: 1 });
  const recorded = site.daemon.jostle("record", "filmed", "-o", "film.mcap", "--steps", "60");
  await site.daemon.command("filmed", "run");
  await recorded;
  await site.daemon.jostle("replay", "film.mcap", "--as", "film", "--paused");

  const page = await site.open("/swarm/film");
  const slider = page.getByRole("slider", { name: "position in the recording" });
  await slider.waitFor();
  await page.locator(".playback", { hasText: "playback of filmed" }).waitFor();
  assert.equal(await page.getByRole("button", { name: "Inject" }).isVisible(), false);
  const first = (await site.row("film"))?.step ?? 0;
  await slider.focus();
  await page.keyboard.press("End");
  const last = await until("it is at its end", async () => {
    const { step } = (await site.row("film")) ?? {};
    return step !== undefined && step > first + 50 ? step : null;
  });
  await until("the page shows it", async () => (await step(page)) === last || null);
  await page.keyboard.press("Home");
  await until(
    "it is back",
    async () => ((await site.row("film"))?.step ?? last) < last - 50 || null,
  );
  await page.getByRole("button", { name: "Run", exact: false }).first().click();
  await until("it has run to its end", async () => (await step(page)) === last || null);

  const anonymous = await site.open("/swarm/film", false);
  const disabled = anonymous.getByRole("slider", { name: "position in the recording" });
  await disabled.waitFor();
  assert.equal(await disabled.isDisabled(), true);
});

test("the picture dims when the daemon stops, and resumes when it is back", async () => {
  await site.daemon.command("school", "run");
  const tab = await site.openTabAt("/swarm/school");
  const { page } = tab;
  await until("a state", () => step(page));
  await page.locator("button.wide", { hasText: "Pause" }).waitFor();
  // When the connection is lost the page requests /api/hello, and reconnects until the daemon is back.
  // What the page has requested since it was opened may be in flight when the daemon is killed.
  const ends = "net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE)";
  const reads = "get/school/get/(parameters|events\\?after=\\d+&limit=256)";
  tab.expectsError(new RegExp(`^Failed to load resource: ${ends} /api/hello$`), 2);
  tab.allowsError(new RegExp(`^Failed to load resource: ${ends} /api/${reads}$`));
  tab.allowsError(
    /^WebSocket connection to '\S+\/api\/ws\?swarm=school' failed: .*(net::ERR_CONNECTION_REFUSED|code: 429)$/,
  );
  await site.daemon.kill();
  await page.getByText("No connection to the daemon, reconnecting").first().waitFor();
  assert.equal(await page.locator(".view.dimmed").count(), 1);
  tab.expectsError(new RegExp(`^Failed to load resource: ${ends} /api/cmd/school/pause$`));
  await page.locator("button.wide").click();
  const unanswered = page.getByText("no reply from the daemon");
  await unanswered.waitFor();
  assert((await step(page)) > 0, "the last numbers are kept");
  await site.daemon.restart();
  await until("the picture", async () => (await page.locator(".view.dimmed").count()) === 0);
  // No message states that the daemon is lost, once it is back.
  assert.equal(await unanswered.count(), 0);
  assert.equal(await page.getByText("No connection").filter({ visible: true }).count(), 0);
  const back = await step(page);
  await until("later steps", async () => (await step(page)) > back + 20);
  await page.keyboard.press(" ");
  await until("commands work", async () => (await site.row("school"))?.phase === "paused");
});

test("pages that reconnect after a restart have the events of one opened then", async () => {
  await site.daemon.create("forgetful", { n: 4 });
  const set = (pi3: number) => site.daemon.command("forgetful", "set", { pi3 });
  const lines = (page: Page) => page.locator(".events li").allTextContents();
  const pages: Page[] = [];
  for (const pi3 of [1.1, 1.2]) {
    await set(pi3);
    const tab = await site.openTabAt("/swarm/forgetful");
    // Requests and connections may end while the daemon is stopped.
    tab.allowsError(/net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE)|code: 429/);
    await until("the event", async () =>
      (await lines(tab.page)).some((it) => it.includes(`${pi3}`)),
    );
    pages.push(tab.page);
  }
  await site.daemon.kill("SIGTERM");
  for (const page of pages) {
    await page.locator(".view.dimmed").waitFor();
  }
  await site.daemon.restart();
  await set(1.3);
  pages.push(await site.open("/swarm/forgetful"));
  await until("the same events", async () => {
    const [one, two, opened] = await Promise.all(pages.map(lines));
    return (
      opened!.some((it) => it.includes("1.3")) && `${one}` === `${opened}` && `${two}` === `${one}`
    );
  });
});
