/** The rater's page. */

import { Flow } from "./flow.js";

const flow = new Flow();
void flow.begin();
// What tests and the browser console can read.
Object.assign(window, {
  __studio: {
    flow,
    get player() {
      return flow.player?.state ?? null;
    },
  },
});
