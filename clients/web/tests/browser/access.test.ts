/** Tokens, users and roles. */
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { test } from "node:test";
import { type Tab, until } from "./browser.ts";
import { Daemon, DYNAMIC_USER, isRoot } from "./daemon.ts";
import { Site, step } from "./site.ts";

const site = new Site();

test("without a token the page disables commands, and the daemon rejects them", async () => {
  await site.daemon.command("school", "run");
  const page = await site.open("/swarm/school", false);
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
    const refused = await site.daemon.post("/api/cmd/school/pause", {}, token);
    assert.equal(refused.status, 401);
    assert.equal(((await refused.json()) as { code: string }).code, "permission_denied");
  }
  assert.equal((await site.row("school"))?.phase, "running");
});

test("a link with a token can be pasted", async () => {
  const page = await site.open("/swarm/school", false);
  await page.locator(".rights").click();
  await page.locator("dialog input").fill(site.daemon.link);
  await page.locator("dialog button.primary").click();
  await until("permission", async () => !(await page.locator("button.wide").isDisabled()));
  await page.reload();
  await until(
    "permission after a reload",
    async () => !(await page.locator("button.wide").isDisabled()),
  );
});

test("a page without a token shows the shell command that prints the link", async (t) => {
  const service = await Daemon.startAsService();
  // After the tabs are closed: an open page would log connection errors.
  t.after(() => service.end());
  const { http, token } = service.addresses;
  const { page } = await visit(http);
  await page.getByText("You are watching: to run, steer, create or delete swarms").waitFor();
  await page.getByText("This daemon has no swarms.").waitFor();
  assert.equal(await page.getByRole("button", { name: "Create a swarm" }).isVisible(), false);
  const command = (await page.locator(".shell code").textContent()) ?? "";
  // Only root can read a service's file; as root the test drops `sudo`.
  assert.equal(command.includes("$(sudo cat "), isRoot, command);
  const line = isRoot ? command.replace("sudo ", "") : command;
  const printed = execFileSync("sh", ["-c", line]).toString();
  assert.equal(printed, `${http}/#token=${token}\n`);
  if (isRoot) {
    // Another user of the machine cannot read it.
    const other = { uid: DYNAMIC_USER + 1, gid: DYNAMIC_USER + 1, stdio: "pipe" } as const;
    assert.equal(execFileSync("sh", ["-c", line], other).toString(), `${http}/#token=\n`);
  }

  // The printed link may be pasted with surrounding white space.
  await page.getByRole("button", { name: "paste the link" }).click();
  assert.equal(await page.locator("dialog .shell code").textContent(), command);
  await page.locator("dialog input").fill(` ${printed}`);
  await page.locator("dialog button.primary").click();
  await page.getByRole("button", { name: "Create a swarm" }).waitFor();
  assert.equal(await page.locator(".shell").filter({ visible: true }).count(), 0);

  const opened = await visit(printed.trim());
  await opened.page.getByRole("button", { name: "Create a swarm" }).waitFor();

  // A link of another site.daemon.
  const stale = await visit(`${http}/#token=${"0".repeat(32)}`);
  await stale.page.getByText("the token of this tab is not this daemon's").waitFor();
  assert.equal(await stale.page.locator(".shell code").textContent(), command);
});

test("with users the page permits what the role of each permits", async (t) => {
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

  const anonymous = await site.openTab();
  // A WebSocket without a token is rejected, and retried.
  anonymous.expectsError(
    /^WebSocket connection to '\S+\/api\/ws' failed: HTTP Authentication failed/,
    Number.POSITIVE_INFINITY,
  );
  await anonymous.page.goto(lab.addresses.http);
  await anonymous.page.getByText("requires a user's token").first().waitFor();
  assert.equal(await anonymous.page.getByText("school").count(), 0);
  // Executes the shell command that the page shows, with vera's credentials.
  const command = (await anonymous.page.locator(".shell code").first().textContent()) ?? "";
  assert.match(command, /^jostle --credentials FOLDER auth link --page http:\/\/127/);
  const vera_link = execFileSync("sh", ["-c", command.replace("FOLDER", `${auth}/people/vera`)], {
    env: {
      ...process.env,
      PATH: `${dirname(jostled)}:${process.env.PATH}`,
      JOSTLE_ENDPOINT: lab.addresses.zenoh,
    },
  });
  assert.equal(vera_link.toString().trim(), `${lab.addresses.http}/#token=${token("vera")}`);

  const enter = async (person: string): Promise<Tab> => {
    const tab = await site.openTab();
    await tab.page.goto(`${lab.addresses.http}/#token=${token(person)}&/swarm/school`);
    await tab.page.getByText(`${person}, `).first().waitFor();
    return tab;
  };
  const removed = await enter("vera");
  const vera = removed.page;
  await vera
    .getByText("You are vera, viewer: commands require the role operator.")
    .first()
    .waitFor();
  await until("vera sees the swarm", async () => (await step(vera)) === 0);
  const { page: olga } = await enter("olga");
  await olga.keyboard.press("s");
  await until("vera sees olga's step", async () => (await step(vera)) === 1);
  await vera.keyboard.press("s");
  await olga.keyboard.press("s");
  await until("only olga steps", async () => (await step(vera)) === 2);
  assert.equal((await lab.post("/api/cmd/school/pause", {}, token("vera"))).status, 403);

  // The page of a removed user says why it is closed, in the picture and above it.
  removed.allowsError(/^WebSocket connection to \S+ failed: HTTP Authentication failed/);
  removed.allowsError(/^401 GET /);
  execFileSync(jostled, ["auth", "--auth-dir", auth, "remove", "vera"]);
  for (const place of [".overlay", ".notice"]) {
    await vera.locator(place, { hasText: "rejected the token of this tab" }).waitFor();
  }
});

async function visit(address: string): Promise<Tab> {
  const tab = await site.openTab();
  await tab.page.goto(address);
  return tab;
}
