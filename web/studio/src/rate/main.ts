/** The rater's page. */

import { Flow } from "./flow.js";

const flow = new Flow();
void flow.begin();
// What tests and the curious may read.
Object.assign(window, {
  __studio: {
    flow,
    get theatre() {
      return flow.theatre?.state ?? null;
    },
  },
});
