// Inlining that a function's own instruction set depends on: what it calls takes that set only as part of it.
#pragma once

#if defined(__GNUC__)
#define FOURD_ALWAYS __attribute__((always_inline))  // of lambdas
#define FOURD_INLINE inline __attribute__((always_inline))
#define FOURD_ALONE __restrict__  // of pointers to what no other pointer of the function leads to
#else
#define FOURD_ALWAYS
#define FOURD_INLINE inline
#define FOURD_ALONE
#endif
