/** Runs the daemon's binary, the environment variable JOSTLED, on free ports. */
import assert from "node:assert/strict";
import { type ChildProcess, execFile, execFileSync, spawn } from "node:child_process";
import {
  chmodSync,
  chownSync,
  copyFileSync,
  mkdirSync,
  mkdtempSync,
  readFileSync,
  rmSync,
  writeFileSync,
} from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { promisify } from "node:util";

export interface Addresses {
  zenoh: string;
  http: string;
  token: string;
}

/** A user id as systemd allocates for a unit with DynamicUser. */
export const DYNAMIC_USER = 61_200;

export const isRoot = process.getuid?.() === 0;

/** The daemon closes a connection after 5 s idle, which can race with the next request. */
const CLOSE = { Connection: "close" };

export class Daemon {
  addresses: Addresses = { zenoh: "", http: "", token: "" };
  private process: ChildProcess | null = null;
  private auth: string | null = null;
  private readonly folder = mkdtempSync(join(tmpdir(), "jostle-page-"));

  /** Starts a daemon; `auth` is its folder of users, if it has any. */
  static async start(auth: string | null = null): Promise<Daemon> {
    const daemon = new Daemon();
    daemon.auth = auth;
    await daemon.begin("tcp/127.0.0.1:0", "127.0.0.1:0");
    return daemon;
  }

  /**
   * Starts a daemon as packaging/jostled.service does, without systemd: `serve` with the settings of
   * the package, data below $STATE_DIRECTORY, umask 0077 and, if the tests run as root, another user.
   */
  static async startAsService(): Promise<Daemon> {
    const daemon = new Daemon();
    const { folder } = daemon;
    const state = join(folder, "jostle");
    mkdirSync(state, { mode: 0o700 });
    const config = join(folder, "jostled.toml");
    writeFileSync(config, execFileSync(binary(), ["config", "default"]));
    const user = isRoot ? { uid: DYNAMIC_USER, gid: DYNAMIC_USER } : {};
    let program = binary();
    if (isRoot) {
      // The folder is accessible to every user, like /var/lib.
      chmodSync(folder, 0o755);
      chownSync(state, DYNAMIC_USER, DYNAMIC_USER);
      // The checkout may be in a folder that only root can access.
      program = join(folder, "jostled");
      copyFileSync(binary(), program);
    }
    const child = spawn(
      "sh",
      ["-c", 'umask 0077; exec "$0" "$@"', program, "serve", "--config", config],
      {
        ...user,
        stdio: ["ignore", "pipe", "pipe"],
        cwd: "/",
        env: {
          PATH: process.env.PATH,
          STATE_DIRECTORY: state,
          JOSTLED_LISTEN: "tcp/127.0.0.1:0",
          JOSTLED_HTTP: "127.0.0.1:0",
        },
      },
    );
    await daemon.waitUntilListening(child);
    return daemon;
  }

  /** Restarts it with the same addresses and data. */
  async restart(): Promise<void> {
    await this.begin(this.addresses.zenoh, this.addresses.http.replace("http://", ""));
  }

  async kill(signal: NodeJS.Signals = "SIGKILL"): Promise<void> {
    const { process } = this;
    this.process = null;
    if (process && process.exitCode === null) {
      const gone = new Promise((resolve) => process.once("exit", resolve));
      process.kill(signal);
      await gone;
    }
  }

  async end(): Promise<void> {
    await this.kill();
    rmSync(this.folder, { recursive: true, force: true });
  }

  get link(): string {
    return `${this.addresses.http}/#token=${this.addresses.token}`;
  }

  async get<T>(path: string): Promise<T> {
    const response = await fetch(`${this.addresses.http}/api/get/${path}`, { headers: CLOSE });
    return (await response.json()) as T;
  }

  post(path: string, args: object, token: string | null = this.addresses.token): Promise<Response> {
    const headers: Record<string, string> = { ...CLOSE, "Content-Type": "application/json" };
    if (token !== null) {
      headers.Authorization = `Bearer ${token}`;
    }
    return fetch(this.addresses.http + path, {
      method: "POST",
      headers,
      body: JSON.stringify(args),
    });
  }

  async command<T>(swarm: string, verb: string, args: object = {}): Promise<T> {
    const response = await this.post(`/api/cmd/${swarm}/${verb}`, args);
    assert.equal(response.status, 200, `${verb}: ${await response.clone().text()}`);
    return (await response.json()) as T;
  }

  async create(name: string, spec: object): Promise<void> {
    const response = await this.post("/api/node/create", { name, spec });
    assert.equal(response.status, 200, `create: ${await response.clone().text()}`);
  }

  /** Runs the `jostle` command line, which is in the daemon's folder. */
  async jostle(...line: string[]): Promise<string> {
    const jostle = join(dirname(process.env.JOSTLED ?? ""), "jostle");
    const run = promisify(execFile);
    return (await run(jostle, ["-e", this.addresses.zenoh, ...line], { cwd: this.folder })).stdout;
  }

  private begin(listen: string, http: string): Promise<void> {
    const users = this.auth === null ? [] : ["--auth-dir", this.auth];
    const args = ["--listen", listen, "--http", http, "--data-dir", this.folder, ...users];
    return this.waitUntilListening(spawn(binary(), args, { stdio: ["ignore", "pipe", "pipe"] }));
  }

  /** Waits until the daemon prints its addresses. */
  private waitUntilListening(child: ChildProcess): Promise<void> {
    this.process = child;
    let output = "";
    return new Promise((resolve, reject) => {
      const read = (chunk: Buffer) => {
        output += chunk;
        const zenoh = /listening on (\S+)/.exec(output)?.[1];
        const http = /http on (http:\/\/[^/\s]+)/.exec(output)?.[1];
        // Without a terminal the daemon prints the path of the token file; with --auth-dir there is no such file.
        const page = /with the token in (\S+)\n/.exec(output)?.[1];
        if (zenoh && http && (page || this.auth)) {
          const token = page ? readFileSync(page, "utf8").trim() : "";
          this.addresses = { zenoh, http, token };
          resolve();
        }
      };
      child.stdout?.on("data", read);
      child.stderr?.on("data", read);
      child.once("exit", (code) => reject(new Error(`jostled ended with ${code}: ${output}`)));
    });
  }
}

function binary(): string {
  const binary = process.env.JOSTLED;
  assert(binary, "set JOSTLED to the daemon's binary");
  return binary;
}
