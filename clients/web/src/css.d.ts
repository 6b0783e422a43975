declare module "*.css";

/** A worker whose script is a part of the script that imports it. */
declare module "*?worker&inline" {
  const InlineWorker: new () => Worker;
  export default InlineWorker;
}
