//
// State_Done_Suspending_Variables.h
//
// Automatically created through MiCASE -- do not change manually!
//
