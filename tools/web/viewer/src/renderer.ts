/** The renderer, which is most of the bytes of the page: a file of its own, that changes rarely. */

export { SparkSplats } from "evogs-three/spark";
