// SPDX-License-Identifier: Apache-2.0
// Prefix sums over a workgroup of THREADS threads.

shared uint scan_sums[THREADS];

void wait_for_all() {
    memoryBarrierShared();
    barrier();
}

// The sum of the values of the threads before this one. All threads must call it.
uint sum_before(uint value, out uint total) {
    uint thread = gl_LocalInvocationIndex;
    scan_sums[thread] = value;
    for (uint reach = 1u; reach < uint(THREADS); reach <<= 1) {
        wait_for_all();
        uint other = thread >= reach ? scan_sums[thread - reach] : 0u;
        wait_for_all();
        scan_sums[thread] += other;
    }
    wait_for_all();
    total = scan_sums[THREADS - 1];
    uint before = scan_sums[thread] - value;
    wait_for_all();
    return before;
}
