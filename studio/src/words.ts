/** All words of the page, in one place. */

const whole = (x: number) => Math.round(x).toString();
/** With one digit; never "-0.0". */
export const tenths = (x: number) => (Math.round(10 * x) / 10 + 0).toFixed(1);

/** An azimuth in degrees, in words: "64° left". */
function side(azimuth: number): string {
  const angle = Math.round(azimuth);
  if (Math.abs(angle) <= 4) return "ahead";
  if (Math.abs(angle) >= 176) return "behind";
  return `${Math.abs(angle)}° ${angle > 0 ? "left" : "right"}`;
}

function height(elevation: number): string {
  const angle = Math.round(elevation);
  return angle === 0 ? "level" : `${Math.abs(angle)}° ${angle > 0 ? "up" : "down"}`;
}

export const words = {
  title: "EAGOR studio",
  brand: "EAGOR",
  brandSub: "studio",
  skip: "Skip to the panorama",
  language: "en",
  noScript: "This page needs JavaScript.",
  side,
  height,
  percent: (share: number) => `${whole(100 * share)} %`,

  tabs: {
    label: "What to look at",
    walk: "Walk",
    run: "Run",
    picture: "Picture",
    live: "Live",
    walkHint: "A camera walks through a simulated apartment",
    runHint: "Episodes of a benchmark, a recording or a robot",
    pictureHint: "A photograph or a video of your own",
    liveHint: "A camera or a stream, as it comes in",
  },

  theme: {
    system: "Colours: as the system",
    dark: "Colours: dark",
    light: "Colours: light",
    change: (next: string) => `change to ${next}`,
  },

  ask: {
    label: "Where is the …",
    placeholder: "white sofa",
    submit: "Ask",
    empty: "Type what to look for.",
    waiting: (query: string) => (query ? `Looking for “${query}” …` : "Looking …"),
  },

  walk: {
    house: "Apartment",
    perception: "Perception",
    drive: "Steered by",
    tour: "tour",
    policy: "policy",
    person: "me",
    start: "Start again",
    pause: "Pause",
    go: "Go on",
    stick: "Steer the camera",
    forward: "Forward",
    back: "Back",
    left: "Turn left",
    right: "Turn right",
    stickHint: "Drag the knob, hold a button, or use the arrow keys.",
    none: "Nothing can look at this",
  },

  run: {
    runs: "Run",
    none: "No runs yet",
    noneChange: (folder: string) =>
      `There is no run in ${folder}. Make one with “eagor bench run navigation --out runs/first”, then come back.`,
    reading: "The run is read …",
    episodes: "Episodes",
    episodesHint: "Failures first, then the largest error.",
    episode: "Episode",
    query: "Query",
    error: "Error",
    found: "Result",
    success: "found",
    failure: "missed",
    unknown: "–",
    loading: "The episode is played again …",
    kind: { bench: "benchmark", live: "recording", robot: "robot" } as Record<string, string>,
    count: (done: number | null, all: number | null) =>
      all === null ? "" : done !== null && done < all ? `${done} of ${all} episodes` : `${all} episode${all === 1 ? "" : "s"}`,
    refresh: "Look for new runs",
  },

  player: {
    label: "Play the episode",
    play: "Play",
    pause: "Pause",
    previous: "Previous step",
    next: "Next step",
    step: "Step",
    at: (n: number, of: number, stamp: number) => `step ${n} of ${of}, ${stamp.toFixed(1)} s`,
  },

  picture: {
    drop: "Drop a picture here",
    dropMore: "A photograph or a video: a panorama (twice as wide as high), or of an ordinary camera. It stays on this machine.",
    choose: "Choose a file",
    other: "Another file",
    uploading: "Reading the file …",
    ready: "The picture is here. Type what to look for.",
    field: {
      ask: "How wide does its camera see?",
      hint: "Degrees across the picture's width. A phone's main camera: about 65 held across, 50 upright.",
      submit: "Use it",
      least: 2,
      most: 150,
      usual: 65,
    },
    limits: (megabytes: number, megapixels: number) =>
      `At most ${whole(megabytes)} MB and ${whole(megapixels)} megapixels.`,
    tooLarge: (megabytes: number, most: number) =>
      `This file has ${whole(megabytes)} MB; at most ${whole(most)} MB are read.`,
    tooLargeChange: "Make it smaller: 2048 columns are enough.",
  },

  live: {
    none: "No camera is connected",
    noneChange: "Start the studio with one: eagor studio --source camera:0",
    source: "Source",
  },

  panorama: {
    label: "Panorama from inside",
    role: "panorama",
    keys: "Drag, or use the arrow keys, to look around; plus and minus zoom; Home looks ahead.",
    keysDrive: "Arrow keys steer the camera. With Shift they look around; plus and minus zoom; Home looks ahead.",
    flat: "The whole panorama, flat",
    flatHint: "Click a place to look there.",
    flatHintOrdinary: "What the camera has shown so far, straight ahead in the middle. The outline is its picture.",
    keysOrdinary: "The camera's picture as it is. An arrow at its edge leads to an answer that is out of view.",
    ahead: "Look ahead",
    zoomIn: "Zoom in",
    zoomOut: "Zoom out",
    answer: "Look at the answer",
    full: "Fill the screen",
    hold: "Hold my view while the camera turns",
    looking: (azimuth: number, elevation: number, field: number) =>
      `You look ${side(azimuth)}, ${height(elevation)}, ${whole(field)}° high.`,
    waiting: "Waiting for the first picture …",
    noPicture: "No picture yet",
    axes: { ahead: "ahead", left: "left", right: "right", behind: "behind" },
  },

  layers: {
    label: "What is drawn",
    heat: "Belief",
    border: (mass: number) => `${whole(100 * mass)} % region`,
    evidence: "Newest look",
    estimate: "Answer",
    modes: "Candidates",
    truth: "Truth",
    rivals: "Methods",
    grid: "Grid",
  },

  status: {
    searching: "searching",
    tracking: "tracking",
    ambiguous: "ambiguous",
    stale: "stale",
    means: {
      searching: "It may not be here, or has not been found yet.",
      tracking: "More likely than not it is here, within 15 degrees of the answer or half its own size.",
      ambiguous: "It is likely here, and several directions fit.",
      stale: "There was an answer, and nothing has been looked at for a while.",
    } as Record<string, string>,
    likely: "It is likely here, but its direction is uncertain.",
    none: "not asked yet",
    waiting: "looking",
  },

  answer: {
    label: "Answer",
    none: "Nothing is known yet",
    presence: "Presence",
    sure: "How sure",
    /** Never 0 % or 100 %. */
    howSure: (share: number) => `${Math.min(Math.max(Math.round(100 * share), 1), 99)} %`,
    isSure: (share: number) => `${words.answer.howSure(share)} sure`,
    cone: (mass: number) => `${whole(100 * mass)} % within`,
    error: "Off the truth by",
    distance: "Distance",
    moving: "It moves",
    entropy: "Entropy",
    nats: (x: number) => `${tenths(x)} nats`,
    look: "Newest look",
    degrees: (x: number) => `${x < 10 ? x.toFixed(1) : whole(x)}°`,
    lookedFor: (name: string) => ` (looked for ${name})`,
    seconds: (x: number) => (x < 10 ? `${x.toFixed(1)} s ago` : `${whole(x)} s ago`),
    slow: "Perception is slow: the answer is predicted from the newest look.",
    never: "none yet",
    metres: (low: string, high: string) => (low === high ? `${low} m` : `${low} to ${high} m`),
    unknown: "–",
  },

  candidates: {
    label: "Candidates",
    hint: "How likely it is thereabouts, if it is here.",
    none: "No candidate stands out.",
    row: (azimuth: number, elevation: number) => `${side(azimuth)}, ${height(elevation)}`,
  },

  polar: {
    label: "All around",
    hint: "Belief by azimuth, seen from above. The grey wedge is what you look at.",
    text: (peak: string, share: number, view: string) =>
      `The belief is densest ${peak}; ${whole(100 * share)} % of it lies within 30° of there. You look ${view}.`,
    empty: "No belief yet.",
  },

  plan: {
    label: "Ground plan",
    hint: "The way so far. The line leads to the answer; where it is thick, the thing is likely to be.",
    text: (walked: number, far: string) =>
      `The camera has walked ${walked.toFixed(1)} m.${far ? ` The answer is ${far} away.` : ""}`,
    none: "No positions: a plan needs a camera that knows where it is.",
    metre: "1 m",
  },

  series: {
    label: "Over time",
    error: "Error",
    presence: "Presence",
    entropy: "Entropy",
    text: (name: string, first: string, last: string, low: string, high: string) =>
      `${name}: ${first} at first, ${last} now, between ${low} and ${high}.`,
    none: "Nothing yet.",
  },

  connection: {
    lost: (seconds: number) => `The server does not answer. Trying again in ${seconds} s.`,
    lostChange: "Is “eagor studio” still running? Start it again: this page comes back by itself.",
    retry: "Try now",
    dismiss: "Close",
  },

  problems: {
    gone: "The server does not answer.",
    goneChange: "Is “eagor studio” still running? Start it again, then try once more.",
    refused: (status: number) => `The server refused this (${status}).`,
    refusedChange: "Reload the page. If that does not help, look at the server's words in its terminal.",
    webgl: "This browser draws no 3D (WebGL 2).",
    webglChange: "Switch on hardware acceleration, or take another browser. Plots and words work without it.",
    episode: "The episode in this file could not be read.",
    episodeChange: "Export it again with “eagor studio export”.",
  },
} as const;
