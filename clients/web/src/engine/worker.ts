/** The worker: receives one job, and executes it. To cancel the job, the page ends the worker. */
import { Engine } from "./engine.ts";
import { execute, failure, type Job, type Report } from "./job.ts";

const report = (it: Report) => postMessage(it);

addEventListener("message", async ({ data }: MessageEvent<Job>) => {
  try {
    const engine = await Engine.of(data.module);
    execute(engine, data, report, () => performance.now());
  } catch (error) {
    report(failure(error));
  }
});
