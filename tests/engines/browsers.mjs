// Prints the replies to scenarios, by a worker in a browser:
//   node browsers.mjs chromium|firefox MODULE REQUESTS

import { readFileSync, writeSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const [browser, module, requests] = process.argv.slice(2);
const load = createRequire(join(here, "../../clients/web/package.json"));

const WORKER = `
  import { answer } from "/scenarios.mjs";
  const get = (path) => fetch(path).then((it) => it.arrayBuffer());
  const post = (path, body) => fetch(path, { method: "POST", body });
  try {
    const compiled = await WebAssembly.compile(await get("/module"));
    await post("/replies", answer(compiled, new TextDecoder().decode(await get("/requests"))));
  } catch (error) {
    await post("/failed", String(error));
  }
`;
const PAGE = `<!doctype html><title>scenarios</title>
  <script>new Worker("/worker.mjs", { type: "module" });</script>`;
const js = "text/javascript";
const served = {
  "/": ["text/html", PAGE],
  "/worker.mjs": [js, WORKER],
  "/scenarios.mjs": [js, readFileSync(join(here, "scenarios.mjs"))],
  "/module": ["application/wasm", readFileSync(module)],
  "/requests": ["text/plain", readFileSync(requests)],
};

/** Opens a browser with a page; returns both. */
async function launch() {
  if (browser === "firefox") {
    const executablePath = process.env.FIREFOX ?? "/usr/bin/firefox-esr";
    const launched = await load("puppeteer-core").launch({ browser, executablePath });
    return { launched, page: await launched.newPage() };
  }
  const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
  const launched = await load("playwright-core").chromium.launch({
    executablePath,
    args: ["--no-sandbox"],
  });
  return { launched, page: await launched.newPage() };
}

const server = createServer();
const posted = new Promise((resolve, reject) => {
  server.on("request", async (request, response) => {
    if (request.method === "POST") {
      const parts = await request.toArray();
      response.end();
      const body = Buffer.concat(parts);
      return request.url === "/replies" ? resolve(body) : reject(new Error(String(body)));
    }
    const [type, body] = served[request.url] ?? ["text/plain", ""];
    response.writeHead(request.url in served ? 200 : 404, { "Content-Type": type }).end(body);
  });
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const { launched, page } = await launch();
try {
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const replies = await posted;
  for (let written = 0; written < replies.length; ) {
    written += writeSync(1, replies, written);
  }
} finally {
  await launched.close();
  server.close();
  server.closeAllConnections();
}
