export { mount } from "./specs.js";
